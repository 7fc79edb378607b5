"""HTML and SVG as values: text is escaped where it enters, so that a log is never read as markup."""

from __future__ import annotations

import base64
import hashlib
import html
import re

_UNPRINTABLE = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")  # no XML has them


class Markup(str):
    """Text that is markup already."""

    __slots__ = ()


def element(name: str, /, *children: str, **attributes: str | float) -> Markup:
    """An element; children that are not Markup are text. `stroke_width` is the attribute stroke-width.

    Without children it closes itself, which HTML takes from its void elements and from those of SVG only.
    """
    written = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{_value(value)}"' for key, value in attributes.items()
    )
    if not children:
        return Markup(f"<{name}{written}/>")
    return Markup(f"<{name}{written}>{joined(*children)}</{name}>")


def svg(view: str, *children: str, **attributes: str | float) -> Markup:
    """A drawing, whose `view` is its viewBox; a picture to those who hear it, without another `role`."""
    seen = {"viewBox": view, "role": "img", **attributes}
    return element("svg", *children, xmlns="http://www.w3.org/2000/svg", **seen)


def joined(*children: str) -> Markup:
    """Several pieces in a row."""
    return Markup("".join(child if isinstance(child, Markup) else _escaped(child) for child in children))


def head(title: str, style: str, *more: Markup, policy: str = "") -> Markup:
    """The head of a document; a `policy` is stated in it in the words of Content-Security-Policy."""
    stated = element("meta", http_equiv="Content-Security-Policy", content=policy) if policy else Markup()
    return element(
        "head",
        element("meta", charset="utf-8"),
        stated,
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="color-scheme", content="light dark"),
        element("title", title),
        *more,
        element("style", Markup(style)),
    )


def in_document(content: bytes, kind: str = "image/jpeg") -> str:
    """The URL of a picture that is in the document itself; `kind` is its media type."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def source_of(text: str) -> str:
    """A script or a style as a policy names it."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _value(value: str | float) -> str:
    return _escaped(value) if isinstance(value, str) else f"{value:.6g}"


def _escaped(text: str) -> str:
    return html.escape(_UNPRINTABLE.sub("\ufffd", text))
