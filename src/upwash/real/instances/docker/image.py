"""What the labels of an image say of the service in it."""

from __future__ import annotations

from collections.abc import Mapping

from upwash.real.instances.service_image import ServiceImage, image_of

_AT_LEAST = {"upwash.concurrency": "1"}  # until its program was asked


def labelled_image(labels: Mapping[str, str], fingerprint: str) -> ServiceImage | None:
    """The image with these labels, of which `upwash.service` and `upwash.program` are enough; None for any other."""
    said = {name: value for name, value in labels.items() if value}
    image = image_of(_AT_LEAST | said, fingerprint)
    return image if image and image.program.path else None
