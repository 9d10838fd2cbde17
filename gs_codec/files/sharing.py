"""Web pages that show a scene, or two versions of it."""

from __future__ import annotations

import base64
import html
import importlib.util
import json
import logging
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from gs_codec.cameras.camera import Camera
from gs_codec.cameras.camera_files import read_cameras
from gs_codec.cameras.inria import as_entry
from gs_codec.cameras.up import BY_CAMERAS, UNSURE, UPS, up_axis, up_of
from gs_codec.cameras.widest import widest_view
from gs_codec.codecs.inspection import Info, inspect_bytes
from gs_codec.config import EGS, LOSSLESS, Config
from gs_codec.egs.egs_file import SectionId, described, read_file
from gs_codec.egs.frame_sections import timeline_of
from gs_codec.egs.header import Feature
from gs_codec.encoding.order import encode
from gs_codec.encoding.request import Request
from gs_codec.errors import InvalidInput, MissingTool
from gs_codec.files.annotations import Annotation, read_annotations
from gs_codec.files.link_preview import PICTURE, picture_of, tags_of
from gs_codec.files.scenes import scene_in
from gs_codec.files.suffixes import check_no_source
from gs_codec.files.tours import read_tour
from gs_codec.formats.coordinates import CONVENTION
from gs_codec.formats.registry import SceneFile, open_scene
from gs_codec.report import Progress, RenderedLoss
from gs_codec.runtime.atomic import atomic_writer, check_folder, check_writable, write_files
from gs_codec.runtime.mapped import located
from gs_codec.runtime.wording import counted, size_text
from gs_codec.scene import Scene
from gs_codec.views.estimate import COUNT, estimate_views
from gs_codec.views.find import near_enough

log = logging.getLogger(__name__)

#: Profile for scenes that pages cannot read directly.
_PROFILE = "l"

#: Scenes with more Gaussians than this are encoded with levels of detail for pages in folders.
_LEVELLED = 1_000_000

#: Name of the page among its files.
PAGE = "index.html"

#: The origin of a site, as browsers state it.
_ORIGIN = re.compile(r"(?!http:.*:80$|https:.*:443$)https?://[a-z0-9._:[\]-]+")

#: The module that shows a page in another one.
_MODULE = "embed.js"


@dataclass(frozen=True)
class Publication:
    """What the links to a page show, and which pages may embed it.

    Parameters
    ----------
    title : str, optional
        Title of the page; by default the names of its scenes.
    url : str, optional
        Address of the page on the web. Some programs show the picture of a link only with it.
    embed : sequence of str
        Origins (``https://example.org``) of other sites whose pages may control this one and save
        its pictures; ``*`` is any. Pages of its own site always may.

    Raises
    ------
    InvalidInput
        If an address or an origin is not one of the web, or a text is not UTF-8.
    """

    title: str | None = None
    url: str | None = None
    embed: Sequence[str] = field(default=())

    def __post_init__(self) -> None:
        for name, text in (("title", self.title), ("url", self.url)):
            if re.search("[\ud800-\udfff]", text or ""):
                raise InvalidInput(f"{name} {text!a}: expected UTF-8")
        if self.url is not None and not re.fullmatch(r"https?://[^/?#\s]+/\S*", self.url):
            raise InvalidInput(f"url '{self.url}': expected the page's: https://example.org/a/")
        for origin in self.embed:
            if origin != "*" and not _ORIGIN.fullmatch(origin):
                raise InvalidInput(
                    f"embed '{origin}': expected * or a site: https://example.org, as browsers "
                    "state it: in lower case, without the default port"
                )


@dataclass(frozen=True)
class SharedScene:
    """A scene of a page.

    Attributes
    ----------
    name : str
        Name of its file.
    data : bytes
        The `.egs` file that the page reads.
    encoded : bool
        Whether it was encoded for the page, because pages cannot read the original file.
    levels : int
        Number of coarser levels of detail; with levels, the page fetches only what it shows.
    frames : int
        Number of frames of a sequence, which the page fetches a group at a time; otherwise 0.
    rendered : RenderedLoss, optional
        Loss in rendered views from encoding it for the page; None if not measured.
    """

    name: str
    data: bytes
    encoded: bool
    levels: int = 0
    frames: int = 0
    rendered: RenderedLoss | None = None


def share(
    sources: Sequence[str | Path],
    target: str | Path,
    cameras: str | Path = "auto",
    *,
    progress: Progress | None = None,
    max_bytes: int | None = None,
    overwrite: bool = False,
    up: str | None = None,
    annotations: str | Path | None = None,
    tour: str | Path | None = None,
    publication: Publication | None = None,
) -> list[SharedScene]:
    """Write a page that shows a scene, or two versions of it, in a browser.

    Raises InvalidInput, CorruptStream, TruncatedStream or UnsupportedVersion, as in `read` and
    `render`; or if there are more than two scenes, the target cannot be written, or a scene encoded
    for the page would replace its source. Raises MissingTool if the page is missing from the
    installed `viewer`.

    Parameters
    ----------
    sources : sequence of str or Path
        One scene or two, in formats supported by `read`. `.egs` files of profiles `paper-*`, `l`,
        `m` and `s` are embedded unchanged, unless decoding needs G-PCC or torchac; others are
        encoded with profile `l`, for a folder with levels of detail if they are large. A sequence
        is shown alone.
    target : str or Path
        A self-contained ``.html`` file; or a folder for any static web server, with the page,
        ``index.html``, the scenes, ``preview.jpg`` for links to it, and ``embed.js``, by which
        other pages show it.
    cameras : str or Path
        The selectable views, as in `render`; the page starts with the first.
    progress : callable, optional
        Called while cameras are estimated and scenes encoded.
    max_bytes : int, optional
        As in `read`.
    overwrite : bool
        As in `encode_file`; for a folder, whether it may contain files.
    up : {"-y", "y", "-z", "z", "-x", "x"}, optional
        Up axis: estimated cameras are upright with respect to it, all views are shown upright, and
        the page rotates about it. By default it is derived from the cameras, given or estimated.
    annotations : str or Path, optional
        A JSON file with points of the scene, each with a title and a text, as in COMMANDS.md.
    tour : str or Path, optional
        A camera path, such as the viewer saves, or any file of cameras. By default, the page's tour
        goes through its views.
    publication : Publication, optional
    """
    target = Path(target)
    notes = [] if annotations is None else read_annotations(annotations)
    path = None if tour is None else read_tour(tour)
    if up is not None:
        up_axis(up)
    if len(sources) not in (1, 2):
        raise InvalidInput(f"{counted(len(sources), 'scene')}, expected one or two")
    alone = target.suffix.lower() == ".html"
    if alone:
        check_writable(target, overwrite)
    elif target.suffix and not target.is_dir():
        raise InvalidInput(f"{target}: expected a .html file or a folder")
    else:
        check_folder(target, overwrite)
    shared, files = page_of(
        sources, cameras, alone, progress=progress, max_bytes=max_bytes, up=up,
        annotations=notes, tour=path, publication=publication or Publication(),
    )  # fmt: skip
    if alone:
        with atomic_writer(target) as file:
            file.write(files[PAGE])
    else:
        for one, name in zip(shared, _file_names(shared), strict=True):
            if one.encoded:
                check_no_source(sources, target / name)
        write_files(target, files)
    return shared


def page_of(
    sources: Sequence[str | Path | Scene],
    cameras: str | Path,
    alone: bool,
    *,
    progress: Progress | None = None,
    max_bytes: int | None = None,
    up: str | None = None,
    annotations: Sequence[Annotation] = (),
    tour: list[dict[str, Any]] | None = None,
    publication: Publication | None = None,
) -> tuple[list[SharedScene], dict[str, bytes]]:
    """The scenes of a page, and its files by name, `PAGE` last; with `alone`, only `PAGE`.

    See `share`. A `Scene` has the coordinates of a PLY. A page without `publication` has no files
    for links and other pages.
    """
    template = _built("page.html").decode()
    given = None if str(cameras) == "auto" else read_cameras(cameras)
    _check_views(annotations, COUNT if given is None else len(given))
    opened = [_open(source, progress, max_bytes, streamed=not alone) for source in sources]
    shared = [one for one, _ in opened]
    if len(shared) == 2 and any(one.frames for one in shared):
        raise InvalidInput("a sequence is shown alone, expected one scene")
    first = opened[0][1]
    finite = first.positions[:, np.isfinite(first.positions).all(axis=0)].astype(np.float64)
    files, entries, blocks = {}, [], []
    for k, (one, name) in enumerate(zip(shared, _file_names(shared), strict=True)):
        entry = _entry(one)
        if alone:
            entries.append(entry | {"data": f"scene-{k}"})
            text = base64.b64encode(one.data).decode()
            blocks.append(_block(f"scene-{k}", "application/octet-stream", text))
        else:
            entries.append(entry | {"url": quote(name)})
            files[name] = one.data
    middle = np.median(finite.astype(np.float64), axis=1) if finite.size else np.zeros(3)
    views, described = _views(given, first, up, progress)
    described |= {
        "middle": middle.tolist(),
        "scenes": entries,
        "annotations": [asdict(one) for one in annotations],
    }
    if tour:
        described["tour"] = tour
    _check_views(annotations, len(views))
    title, tags = " and ".join(one.name for one in shared), ""
    if publication:
        title = publication.title or title
        if publication.embed:
            described["embed"] = list(publication.embed)
        shown = None if alone else views[0]
        tags = tags_of(title, _description(opened), publication.url, shown)
        if shown:
            scenes = [scene for _, scene in opened]
            files[PICTURE] = picture_of(scenes, shown, None if up is None else up_axis(up))
            files[_MODULE] = _built(_MODULE)
    # No text of a file can close the element that contains it.
    listed = json.dumps(described, allow_nan=False).replace("<", "\\u003c")
    data = "\n".join([_block("scene-list", "application/json", listed), *blocks])
    files[PAGE] = _fill(template, title=html.escape(title), tags=tags, data=data).encode()
    return shared, files


def _check_views(annotations: Sequence[Annotation], count: int) -> None:
    """Check that the views of annotations are among the page's."""
    for k, note in enumerate(annotations, 1):
        if note.view is not None and note.view >= count:
            many = counted(count, "view")
            raise InvalidInput(f"annotation {k}: view {note.view}, expected one of {many}")


def _description(opened: Sequence[tuple[SharedScene, Scene]]) -> str:
    """What a page shows, in a line."""
    sizes = [
        f"{counted(scene.count, 'Gaussian')}, {size_text(len(one.data))}" for one, scene in opened
    ]
    return f"3D Gaussian splatting scene: {'; '.join(sizes)}"


def _entry(one: SharedScene) -> dict[str, Any]:
    """Description of a scene for a page, without its location."""
    entry = {"name": one.name, "encoded": one.encoded, "levels": bool(one.levels)}
    if one.frames:
        entry["frames"] = one.frames
    return entry if one.rendered is None else entry | {"psnr": one.rendered.psnr}


def _views(
    given: list[Camera] | None, scene: Scene, up: str | None, progress: Progress | None
) -> tuple[list[Camera], dict[str, Any]]:
    """The views of a page: given ones, or estimated ones.

    Their description has the overview, the possible up axes by name, and the current one, too.
    """
    home = 0
    if given is None:
        axis = None if up is None else up_axis(up)
        found = estimate_views(scene, COUNT, axis, progress)
        views, by_cameras = found.cameras, found.up
        if up is None and not found.up_certain:
            log.warning(UNSURE)
    else:
        views = near_enough(given, scene)
        by_cameras = up_of([view.rotation for view in views])
        home = widest_view(scene, views)
    ups = {BY_CAMERAS: by_cameras} | UPS
    return views, {
        "views": [as_entry(index, camera) for index, camera in enumerate(views)],
        "home": home,
        "ups": {name: axis.tolist() for name, axis in ups.items()},
        "up": up or BY_CAMERAS,
    }


def _open(
    source: str | Path | Scene,
    progress: Progress | None,
    max_bytes: int | None,
    streamed: bool = False,
) -> tuple[SharedScene, Scene]:
    """A scene, and its Gaussians as shown by a page, which may fetch parts of it if `streamed`."""
    if isinstance(source, Scene):
        return _encoded("cloud", source, progress, streamed)
    path = Path(source)
    with open_scene(path) as file:
        frames, data = 0, file.data
        if file.format == EGS:
            with located(path):
                frames, file = _first_frame(file)
        scene = scene_in(file, "drop", progress, CONVENTION, max_bytes)
        if file.format == EGS:
            info = inspect_bytes(file.data)
            if is_read_by_pages(info):
                levels = len(info.levels)
                return SharedScene(_name(path), bytes(data), False, levels, frames), scene
        with located(path):
            return _encoded(_name(path), scene, progress, streamed)


def is_read_by_pages(info: Info) -> bool:
    """Whether pages can read an `.egs` file directly."""
    known = (Feature.FAR | Feature.LOCAL_BASIS).labels
    return info.profile != LOSSLESS and set(info.features) <= set(known)


def _first_frame(file: SceneFile) -> tuple[int, SceneFile]:
    """The number of frames of a sequence, and its first; 0 and the file itself if it is a scene."""
    whole = read_file(file.data, described)
    if Feature.SEQUENCE not in whole.header.features:
        return 0, file
    count = timeline_of(whole).count
    position, size, _ = whole.table[SectionId.KEY_FRAME, 0]
    return count, replace(file, data=file.data.window(position, size))


def _encoded(
    name: str, scene: Scene, progress: Progress | None, streamed: bool
) -> tuple[SharedScene, Scene]:
    """A scene encoded for a page; with levels of detail if it is large and `streamed`."""
    lod = streamed and scene.count > _LEVELLED
    config = Config(_PROFILE, extra="drop", nonfinite="drop", lod=lod)
    parts, report = encode(scene, Request(config), progress)
    if report.dropped:
        found = counted(report.dropped, "Gaussian")
        log.warning("%s: left out: %s with NaN or infinity", name, found)
    data = b"".join(parts)
    levels = len(inspect_bytes(data).levels)
    return SharedScene(name, data, True, levels, rendered=report.rendered), scene


def _name(path: Path) -> str:
    """The name of a file; bytes that are not UTF-8 become U+FFFD."""
    return path.name.encode(errors="surrogateescape").decode(errors="replace")


def _file_names(shared: Sequence[SharedScene]) -> list[str]:
    """Distinct file names for the scenes."""
    names = [Path(one.name).with_suffix(".egs").name for one in shared]
    if len(names) == 2 and names[0].lower() == names[1].lower():
        names = [f"{letter}-{name}" for letter, name in zip("ab", names, strict=True)]
    return names


def _built(name: str) -> bytes:
    """A file of the web viewer; `page.html` is the built page, without scenes."""
    spec = importlib.util.find_spec("viewer")
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        built = Path(folder, "web", name)
        if built.is_file():
            return built.read_bytes()
    raise MissingTool(f"viewer/web/{name}: no such file; install gs-codec again")


def _fill(template: str, **parts: str) -> str:
    for name, text in parts.items():
        before, _, after = template.partition(f"<!--{name}-->")
        template = before + text + after
    return template


def _block(name: str, kind: str, text: str) -> str:
    """An inert data element of a page."""
    return f'<script type="{kind}" id="{name}">{text}</script>'
