"""Figures for publications, drawn with matplotlib: one style, as PNG, PDF and SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class FigureFiles:
    """The folder of figures, and their formats: png, pdf, svg."""

    folder: Path
    formats: Sequence[str] = ("png",)

    def files(self, name: str) -> list[Path]:
        """The paths of the figure's files, one for each format."""
        return [self.folder / f"{name}.{suffix}" for suffix in self.formats]
