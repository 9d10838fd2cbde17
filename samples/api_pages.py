"""Write the HTML reference of the public names of gs_codec and viewer; run by `make docs`.

    python samples/api_pages.py build/docs

Needs pdoc (extra ``docs``). pdoc sees neither lazily loaded names nor which names of a module are
public, so both are set here.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import gs_codec

#: Packages whose names are public.
PACKAGES = ("gs_codec", "gs_codec.edit", "viewer")

#: Types returned by functions of `viewer`, by the module they are imported from.
TYPES = {"viewer.plugin": ("Actions",)}


#: The first page: every name with its summary line.
INDEX = """
{% extends "default/index.html.jinja2" %}
{% block title %}gs_codec {{ version }}{% endblock %}
{% block content %}
<header class="pdoc">
<h1>gs_codec {{ version }}</h1>
<input type="search" placeholder="Search ..." aria-label="search box">
</header>
<main class="pdoc">
<section class="module-info">
{% for page in all_modules.values() %}
{% set url = page.modulename | replace(".", "/") ~ ".html" %}
<h2><a href="{{ url }}">{{ page.modulename }}</a></h2>
<dl>
{% for each in page.members.values() %}
<dt><a href="{{ url }}#{{ each.name }}">{{ each.name }}</a></dt>
<dd>{{ each.docstring.split("\n\n")[0] | replace("`", "") }}</dd>
{% endfor %}
</dl>
{% endfor %}
</section>
</main>
{% include "search.html.jinja2" %}
{% endblock %}
"""

STYLE = """
.pdoc dl { display: grid; grid-template-columns: 11rem 1fr; gap: 0 1rem; }
.pdoc dt { font-weight: normal; }
.pdoc dd { margin: 0; }
header.pdoc h1 { width: 100%; margin: 1rem 0 0; }
"""


def pages() -> dict[str, tuple[str, ...]]:
    """Names on each page: those of packages, then the types they refer to."""
    public = {name: tuple(import_module(name).__all__) for name in PACKAGES}
    return public | TYPES


def main(folder: Path) -> None:
    """Render the pages into a folder."""
    import pdoc
    from jinja2 import ChoiceLoader, DictLoader

    for name, names in pages().items():
        module = import_module(name)
        vars(module).update({each: getattr(module, each) for each in names}, __all__=list(names))
    # Fields are documented in the docstring of their class.
    pdoc.render.configure(docformat="numpy", include_undocumented=False, show_source=False)
    own = DictLoader({"index.html.jinja2": INDEX, "custom.css": STYLE})
    pdoc.render.env.loader = ChoiceLoader([own, pdoc.render.env.loader])
    pdoc.render.env.globals["version"] = gs_codec.__version__
    pdoc.pdoc(*pages(), output_directory=folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
    print(f"open {Path(sys.argv[1]) / 'index.html'}")
