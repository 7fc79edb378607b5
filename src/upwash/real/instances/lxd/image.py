"""The images of services that an LXD or Incus holds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from upwash.real.instances.lxd.engine import EngineImage
from upwash.real.instances.service_image import ServiceImage, image_of


def newest_images(images: Iterable[EngineImage]) -> Mapping[str, ServiceImage]:
    """Of each service the image that was imported last, by the service's name; other people's are left aside."""
    found: dict[str, ServiceImage] = {}
    for each in sorted(images, key=lambda each: each.uploaded_at):
        if image := image_of(each.properties, each.fingerprint):
            found[image.service] = image
    return found
