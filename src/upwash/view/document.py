"""The flight page as one HTML document: its scripts and styles are in it, and it refers to no other file."""

from __future__ import annotations

import functools
import re
from graphlib import TopologicalSorter
from importlib.resources import files

from upwash.report.markup import Markup, element, head, in_document, source_of
from upwash.report.palette import stylesheet

_PAGE = files("upwash.view") / "page"
_LEAFLET = files("js_lib_leaflet") / "static" / "js_lib_leaflet"
_IMPORT = re.compile(r'^import (\{[^}]*\}|\* as L) from "\./([\w./-]+)";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export ((?:class|const|function) (\w+))", re.MULTILINE)
_LEAFLET_MODULE = "leaflet/leaflet-src.esm.js"  # which leaflet.js is too, as the global L


def document(title: str, *, policy: str = "") -> tuple[Markup, Markup]:
    """The page before and after more content; a `policy` is stated in the document itself.

    A policy is in the words of Content-Security-Policy, without the document's own `sources`.
    """
    icon = element("link", rel="icon", href=_icon())
    opened = head(title, _style(), icon, policy=f"{policy}; {sources()}" if policy else "")
    begin = f'<!DOCTYPE html>\n<html lang="en">{opened}<body>{_read("body.html")}'
    return Markup(begin), Markup(f"<script>{_script()}</script></body></html>\n")


@functools.cache
def sources() -> str:
    """What a policy has to say of the scripts and styles that are in the document: these run, and no others."""
    return f"script-src {source_of(_script())}; style-src {source_of(_style())}"


def _read(name: str) -> str:
    return (_PAGE / name).read_text(encoding="utf-8")


@functools.cache
def _icon() -> str:
    return in_document((_PAGE / "icon.svg").read_bytes(), "image/svg+xml")


@functools.cache
def _style() -> str:
    names = (file.name for file in _PAGE.iterdir() if file.name.endswith(".css"))
    own = sorted(names, key=lambda name: (name == "print.css", name))  # paper has the last word
    leaflet = (_LEAFLET / "leaflet.css").read_text(encoding="utf-8")
    return "\n".join([leaflet, stylesheet(), *map(_read, own)])


@functools.cache
def _script() -> str:
    """Leaflet, and each module of the page as a function that runs after the modules that it imports."""
    modules = {file.name: _read(file.name) for file in _PAGE.iterdir() if file.name.endswith(".js")}
    needs = {
        name: [needed for _, needed in _IMPORT.findall(text) if needed in modules]
        for name, text in modules.items()
    }
    leaflet = (_LEAFLET / "leaflet.js").read_text(encoding="utf-8").partition("//# sourceMappingURL")[0]
    ordered = [_as_function(name, modules[name]) for name in TopologicalSorter(needs).static_order()]
    return "\n".join([leaflet, "const modules = {};", *ordered])


def _as_function(name: str, text: str) -> str:
    exported = ", ".join(found for _, found in _EXPORT.findall(text))
    body = _EXPORT.sub(r"\1", _IMPORT.sub(_as_constants, text))
    return f'modules["{name}"] = (() => {{\n"use strict";\n{body}return {{ {exported} }};\n}})();'


def _as_constants(match: re.Match[str]) -> str:
    names, module = match.groups()
    if names == "* as L":
        return ""
    return f"const {names} = L;\n" if module == _LEAFLET_MODULE else f'const {names} = modules["{module}"];\n'
