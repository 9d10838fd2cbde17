"""Build the documentation as a site for a web server or a disk; run by `make docs`.

    python samples/documentation.py build/docs

Needs the extra ``docs``. Documents are copied from where they are, so that their links work as in
the repository; the references of commands and of Python are written from the program itself.
"""

from __future__ import annotations

import argparse
import builtins
import os
import re
import shutil
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import gs_codec

ROOT = Path(__file__).parents[1]

#: Packages whose names are public.
PACKAGES = ("gs_codec", "gs_codec.edit", "viewer")

#: Types returned by functions of `viewer`, by the module they are imported from.
TYPES = {"viewer.plugin": ("Actions",), "viewer.notebook": ("Embedded",)}

#: Pages in the order of the navigation: title and document without suffix, by heading.
PAGES = {
    "Start": {
        "Overview": "README",
        "Tutorial": "samples/TUTORIAL",
        "How it works": "samples/docs/how_it_works",
    },
    "How to": {
        "Small for the web": "samples/docs/small_for_the_web",
        "Tiles for Cesium": "samples/docs/tiles_for_cesium",
        "Archive": "samples/docs/archive",
        "Clean and edit": "samples/docs/clean",
        "Compare": "samples/docs/compare",
        "Batches and clusters": "samples/docs/batches",
        "In Python": "samples/docs/in_python",
        "In a trainer": "samples/docs/in_a_trainer",
        "From Open3D": "samples/docs/from_open3d",
        "From gsplat": "samples/docs/from_gsplat",
        "From nerfstudio": "samples/docs/from_nerfstudio",
        "In a browser": "samples/docs/in_a_browser",
    },
    "Reference": {
        "Commands by topic": "gs_codec/cli/COMMANDS",
        "Commands and options": "reference/commands",
        "Python": "reference/python",
        "Formats": "gs_codec/formats/FORMATS",
        "Cameras": "gs_codec/cameras/CAMERAS",
        "Batches": "gs_codec/batch/BATCH",
        "Window": "viewer/README",
        "Web page": "viewer/web/README",
        "Viewers compared": "samples/docs/viewers",
        "Samples": "samples/README",
        "The .egs format": "gs_codec/egs/FORMAT",
    },
    "Background": {
        "Results": "gs_codec/bench/RESULTS",
        "Lab notebook": "gs_codec/bench/LAB_NOTEBOOK",
        "Findings": "gs_codec/analysis/FINDINGS",
        "The paper": "gs_codec/PAPER",
        "Untrusted files": "gs_codec/TRUST",
        "Contributing": "CONTRIBUTING",
        "Changes": "CHANGELOG",
    },
}

#: Pages that are not documents of the repository.
WRITTEN = ("reference/commands", "reference/python")

SETTINGS = {
    "project": "gs_codec",
    "version": gs_codec.__version__,
    "release": gs_codec.__version__,
    "root_doc": "README",
    "extensions": [
        "myst_parser",
        "sphinx.ext.autodoc",
        "sphinx.ext.autosummary",
        "sphinx.ext.napoleon",
        "sphinx_copybutton",
    ],
    "html_theme": "furo",
    "html_title": f"gs_codec {gs_codec.__version__}",
    "html_copy_source": False,
    "html_show_sphinx": False,
    # Excerpts would be fetched, which browsers refuse to pages from disk.
    "html_show_search_summary": False,
    "smartquotes": False,
    "highlight_language": "bash",
    # The anchors of GitHub.
    "myst_heading_anchors": 6,
    # Names in backticks are links if they are public.
    "default_role": "py:obj",
    "toc_object_entries_show_parents": "hide",
    "maximum_signature_line_length": 80,
    "autodoc_default_options": {"members": True},
    "autodoc_member_order": "bysource",
    "autodoc_typehints_format": "short",
    "napoleon_google_docstring": False,
    "autosummary_generate": False,
}


#: Beginnings of the headings that come after all other options of a command.
LAST = ("Expert", "Actions")


def public_names() -> dict[str, tuple[str, ...]]:
    """Public names by module: those of packages, then the types they refer to."""
    return {name: tuple(import_module(name).__all__) for name in PACKAGES} | TYPES


def copy_documents(folder: Path) -> None:
    """Copy the documents and the files they link to; the first gets the navigation."""
    documents = {page for pages in PAGES.values() for page in pages.values()} - set(WRITTEN)
    for name in sorted(documents):
        source = ROOT / f"{name}.md"
        text = source.read_text(encoding="utf-8")
        for link in re.findall(r"\]\(([^)#\s]+)", text):
            linked = (source.parent / link).resolve()
            if linked.is_file() and linked.suffix != ".md":
                copied = folder / linked.relative_to(ROOT)
                copied.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(linked, copied)
        target = folder / f"{name}.md"
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text + navigation() * (name == "README"), encoding="utf-8")


def navigation() -> str:
    """The table of contents, for the sidebar."""
    parts = []
    for heading, pages in PAGES.items():
        lines = [f"{title} <{page}>" for title, page in pages.items() if page != "README"]
        options = [":hidden:", ":titlesonly:", f":caption: {heading}"]
        parts.append("\n".join(["```{toctree}", *options, *lines, "```"]))
    return "\n\n" + "\n\n".join(parts) + "\n"


def titled(title: str, mark: str = "=") -> str:
    """A heading of reStructuredText."""
    return f"\n{title}\n{mark * len(title)}\n"


def plain(text: str) -> str:
    """Help text in reStructuredText, with what is in backticks as code."""
    parts = re.sub(r"\[/?dim\]", "", text).split("`")
    parts[::2] = [re.sub(r"([*_|\\])", r"\\\1", part) for part in parts[::2]]
    return "``".join(parts)


def python_reference() -> str:
    """The page of public names."""
    lines = [titled("Python", "#")]
    for module, names in public_names().items():
        lines += [titled(module), f".. currentmodule:: {module}\n"]
        lines += [".. autosummary::", "   :nosignatures:\n", *(f"   {name}" for name in names)]
        for name in names:
            kind = type_of(getattr(import_module(module), name))
            lines.append(f"\n.. auto{kind}:: {module}.{name}")
    return "\n".join(lines) + "\n"


def type_of(value: Any) -> str:
    """The name of Sphinx for a kind of object."""
    if not isinstance(value, type):
        return "function"
    return "exception" if issubclass(value, Exception) else "class"


def command_reference() -> str:
    """The page of all commands with all options, expert ones included."""
    from typer.main import get_command

    from gs_codec.cli.main import NAMES, app
    from viewer.main import app as viewer

    group: Any = get_command(app)
    lines = [titled("Commands and options", "#")]
    lines.append("Everything that ``--help`` shows, from the commands themselves.\n")
    for name in NAMES:
        lines += described(f"gs-codec {name}", group.get_command(None, name))
    lines += described("gs-viewer", get_command(viewer))
    return "\n".join(lines) + "\n"


def described(name: str, command: Any) -> Iterator[str]:
    """The lines of a command and its subcommands."""
    from gs_codec.cli.command import argument_names

    yield titled(name)
    yield plain((command.help or "").partition("\f")[0]) + "\n"
    if hasattr(command, "commands"):
        for each in command.commands:
            yield from described(f"{name} {each}", command.get_command(None, each))
        return
    yield f".. program:: {name}\n"
    yield f"::\n\n   {' '.join([name, '[OPTIONS]', *argument_names(command)])}\n"
    panels: dict[str, list[Any]] = {}
    for each in command.params:
        if each.param_type_name == "argument":
            panel = "Arguments"
        else:
            panel = each.rich_help_panel or ("Expert options" if each.hidden else "Options")
        panels.setdefault(panel, []).append(each)
    for panel in sorted(panels, key=lambda name: (name.startswith(LAST), name != "Arguments")):
        yield f".. rubric:: {panel}\n"
        for each in panels[panel]:
            yield from option(each)


def option(each: Any) -> Iterator[str]:
    """The lines of an argument or option."""
    value = "" if getattr(each, "is_flag", False) else each.metavar or each.type.name.upper()
    names = [value] if each.param_type_name == "argument" else [*each.opts, *each.secondary_opts]
    default = each.show_default if isinstance(each.show_default, str) else each.default
    said = default and default is not True and each.show_default
    shown = f" Default: {plain(str(default))}." if said else ""
    yield f".. option:: {', '.join(f'{n} {value}'.strip() if n != value else n for n in names)}\n"
    yield f"   {plain(each.help or '')}{shown}\n"


def keep_dots(*arguments: Any) -> None:
    """Show suffixes such as `.egs` as code, because a reference would lose its dot."""
    lines = arguments[-1]
    lines[:] = [re.sub(r"(?<!`)(`\.[^`]+`)(?!`)", r"`\1`", line) for line in lines]


def unlink_builtins(_: Any, tree: Any) -> None:
    """Leave types such as `bytes` without a link: reports have attributes of these names."""
    from sphinx.addnodes import pending_xref

    for node in list(tree.findall(pending_xref)):
        if hasattr(builtins, node.get("reftarget", "")):
            node.replace_self(node.children)


def main(folder: Path) -> None:
    """Build the site; a broken link or a wrong reference is an error."""
    from sphinx.application import Sphinx
    from sphinx.util.docutils import docutils_namespace

    shutil.rmtree(folder, ignore_errors=True)
    source = folder / "source"
    copy_documents(source)
    for name, text in zip(WRITTEN, (command_reference(), python_reference()), strict=True):
        (source / name).parent.mkdir(exist_ok=True)
        (source / f"{name}.rst").write_text(text, encoding="utf-8")
    with docutils_namespace():
        site = Sphinx(
            source, None, folder, folder / "doctrees", "html", SETTINGS,
            status=None, warningiserror=True,
        )  # fmt: skip
        site.connect("autodoc-process-docstring", keep_dots, priority=400)
        site.connect("doctree-read", unlink_builtins)
        site.build()
    if site.statuscode:
        sys.exit(site.statuscode)
    for each in (source, folder / "doctrees"):
        shutil.rmtree(each)
    shutil.copy(folder / "README.html", folder / "index.html")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="a site built before, or an empty or new folder")
    target = parser.parse_args().folder
    entries = set(os.listdir(target)) if target.exists() else set()
    if entries and not entries & {"objects.inv", "doctrees"}:
        parser.error(f"{target}: not empty, expected a site built before, or a new folder")
    main(target)
    print(f"open {target / 'index.html'}")
