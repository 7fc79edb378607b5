"""Kinds of number that settings hold; a description is what an error says was expected."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

Positive = Annotated[float, Meta(gt=0, description="a number above 0")]
NotNegative = Annotated[float, Meta(ge=0, description="a number of at least 0")]
Share = Annotated[float, Meta(gt=0, le=1, description="a number above 0, up to 1")]
