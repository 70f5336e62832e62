"""How Sphinx builds the site: `make docs`, or sphinx-build -n -W --keep-going docs build/site."""

from __future__ import annotations

import os
import pkgutil
import re
import sys
import warnings
from importlib import import_module
from pathlib import Path
from typing import Any

import loky
import matplotlib
from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.config import ENUM

matplotlib.use("Agg")
# A million arms need memory, after which joblib begins a new worker, as it should.
warnings.filterwarnings("ignore", message="A worker stopped while some jobs were given")
DOCS = Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS), str(DOCS.parent)]
# Examples that start processes, or name a module of theirs, find it from the root of the project.
os.environ["PYTHONPATH"] = os.pathsep.join([str(DOCS.parent), os.environ.get("PYTHONPATH", "")])

import generate  # noqa: E402

import mmc_gym  # noqa: E402

# Autodoc imports what is not there yet as type checkers do, which pydantic takes amiss.
for module in pkgutil.walk_packages(mmc_gym.__path__, "mmc_gym."):
    import_module(module.name)

project = "mmc-gym"
author = "The mmc-gym developers"
copyright = author
version = release = mmc_gym.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["playground"]
templates_path: list[str] = []
default_role = "literal"  # `name` in a docstring is code
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
nitpick_ignore_regex = [
    # The build needs no network, and so has no lists of what other projects document.
    (r"py:.*", r"(?!mmc_gym\.).*"),
    # Private classes, parts and states of agents, and bases: annotations name them.
    (r"py:.*", r"mmc_gym\.(\w+\.)*_\w+"),
    (r"py:.*", r"mmc_gym\.agents\.(body_model\.(?!(agent|parts)\.).*|\w+\.(Belief|SavedModel))"),
    (r"py:.*", r"mmc_gym\.agents\.([a-z_]+\.)+\w+State"),
    # What a range and the arms' drawn numbers are inside.
    (r"py:.*", r"mmc_gym\.envs\.(changes\.Direction|names\.Range)"),
    (r"py:.*", r"mmc_gym\.envs\.(reach\.GoalEnvironment|scenarios\.OwnFacts)"),
    (r"py:.*", r"mmc_gym\.benchmark\.store\.(CellKey|Policy)"),
    (r"py:.*", r"mmc_gym\.robots\.records\.(Hold|Records)"),
    # Type variables, and names of types that are no classes.
    (r"py:.*", r"mmc_gym\.agents\.base\.State"),
    (r"py:.*", r"mmc_gym\.measures\.catalogue\.(OfEpisodes?|Quantity)"),
]

html_math_renderer = "mathml"  # which browsers set by themselves, without a network
html_theme = "pydata_sphinx_theme"
html_title = "mmc-gym"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_favicon = "_static/favicon.svg"
html_extra_path = ["_generated/extra"]
html_theme_options = {
    "header_links_before_dropdown": 7,
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
    "show_prev_next": False,
    "show_toc_level": 2,
}
html_sidebars = {page: [] for page in ["index", "install", "quickstart", "faq", "envs/*"]}
html_show_sourcelink = False

sphinx_gallery_conf = {
    "examples_dirs": ["../examples"],
    "gallery_dirs": ["examples"],
    "subsection_order": [f"../examples/{folder}" for folder in generate.GALLERY],
    "within_subsection_order": "generate.FromEasyToDeep",
    "image_scrapers": ["generate.scrape"],
    "filename_pattern": r"plot_",
    "ignore_pattern": r"__init__\.py",
    "download_all_examples": False,
    "min_reported_time": 1,
    "show_memory": False,
    "nested_sections": False,
    "parallel": min(loky.cpu_count(), 4),
    "copyfile_regex": r".*\.ipynb",
}


def _to_restructured_text(
    app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]
) -> None:
    """Let a docstring mean in reStructuredText what it means to a reader of the code."""
    found: list[str] = []
    is_literal = False
    for line in lines:
        above = next((one for one in reversed(found) if one), "")
        after_gap = bool(found) and not found[-1]
        # An indented block is an equation or a list of commands: keep its lines.
        if line.startswith("    ") and after_gap and above and not above.startswith(" "):
            is_literal = True
            found += [] if above.endswith("::") else ["::", ""]
        elif line and not line.startswith("    "):
            is_literal = False
        if not is_literal and ">>>" not in line:
            # Words before a colon are no type: types are annotations.
            if re.fullmatch(r" *(Returns|Yields):", above) and ": " in line:
                line = re.sub(r"^( *)", r"\1: ", line)
            if what in ("attribute", "property") and not found:
                line = f": {line}"
            # Bars are absolute values, and asterisks patterns.
            parts = line.split("`")
            parts[::2] = [re.sub(r"([|*])", r"\\\1", part) for part in parts[::2]]
            line = "`".join(parts)
        found.append(line)
    lines[:] = found


def _shorten_environments(
    app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]
) -> None:
    """Leave what an environment's docstring says in Markdown to the environment's page."""
    headings = [number for number, line in enumerate(lines) if line.startswith("## ")]
    if headings:
        page = generate.PAGE_OF_CLASS.get(thing, "/envs/reach")
        lines[headings[0] :] = [f"More: :doc:`{page}`.", ""]


def _shorten_array_types(app: Any, domain: str, kind: str, content: Any) -> None:
    """Say ndarray, without the generic types of its shape and elements: docstrings have these."""
    generic = re.compile(r"(~?numpy\.)?ndarray\[tuple\[.*?\], (~?numpy\.)?dtype\[[^]]*\]\]")
    for of_object in app.env.current_document.autodoc_annotations.values():
        for name, text in of_object.items():
            of_object[name] = generic.sub("~numpy.ndarray", text)


def _set_math(writer: Any, node: Any) -> None:
    """Write a formula as MathML."""
    is_block = isinstance(node, nodes.math_block)
    tag = "div" if is_block else "span"
    formula = tex2mathml(node.astext(), as_block=is_block)
    writer.body.append(f'<{tag} class="math notranslate">{formula}</{tag}>')
    raise nodes.SkipNode


def setup(app: Any) -> None:
    """Write what is generated; mend docstrings on their way to autodoc."""
    (DOCS / "_generated" / "extra").mkdir(parents=True, exist_ok=True)  # looked for at once
    app.add_config_value("films", "some", "env", types=ENUM("all", "some", "none"))
    app.add_html_math_renderer("mathml", (_set_math, None), (_set_math, None))
    app.connect("builder-inited", generate.write_all, priority=100)
    app.connect("builder-inited", generate.write_thumbnails, priority=600)  # after the gallery
    app.connect("autodoc-process-docstring", _shorten_environments, priority=100)
    app.connect("object-description-transform", _shorten_array_types, priority=100)
    app.connect("autodoc-process-docstring", _to_restructured_text, priority=101)
