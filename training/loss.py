"""How far off the network's guesses are, and which of them should have found what.

As in YOLOv3, a box belongs to the cell of its centre, and there to the anchors that resemble it; another guess that
overlaps the box well is ignored. Unlike in YOLOv3, boxes are compared by their overlap (complete IoU), which weighs a
pixel in a small box as it should.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from training.network import Head

_LIKE_ANCHOR = 0.35  # least overlap of a box's shape with an anchor's to belong to it too
_NEARLY_RIGHT = 0.5  # guesses without a box are ignored from this overlap on
_BOX_WEIGHT, _CLASS_WEIGHT = 2.5, 0.5


def detection_loss(heads: Sequence[Head], boxes: Tensor) -> Tensor:
    """The loss over a batch; boxes are rows of photo index, label index, left, top, right, bottom."""
    owners = _owners(heads, boxes)
    return torch.stack([_head_loss(*each, boxes) for each in zip(heads, owners, strict=True)]).sum()


def _owners(heads: Sequence[Head], boxes: Tensor) -> list[Tensor]:
    """For each head, the box (row) that each anchor (column) should find."""
    sizes = boxes[:, 4:6] - boxes[:, 2:4]
    anchors = torch.cat([head.anchors_px for head in heads])
    shared = torch.minimum(sizes[:, None], anchors[None]).prod(-1)
    likeness = shared / (sizes.prod(-1)[:, None] + anchors.prod(-1)[None] - shared)
    best = functional.one_hot(likeness.argmax(1), len(anchors)).bool()
    return list((best | (likeness > _LIKE_ANCHOR)).split([len(head.anchors_px) for head in heads], dim=1))


def _head_loss(head: Head, owners: Tensor, boxes: Tensor) -> Tensor:
    guesses = _decode(head)
    which, anchor = owners.nonzero(as_tuple=True)
    own = boxes[which]
    middle = (own[:, 2:4] + own[:, 4:6]) / 2
    rows, columns = head.raw.shape[2:4]
    column = (middle[:, 0] / head.stride_px).long().clamp(0, columns - 1)
    row = (middle[:, 1] / head.stride_px).long().clamp(0, rows - 1)
    at = (own[:, 0].long(), anchor, row, column)

    wanted = torch.zeros(guesses.shape[:-1])
    wanted[at] = 1
    judged = (wanted == 1) | ~_nearly_right(guesses.detach(), boxes)
    objects = functional.binary_cross_entropy_with_logits(head.raw[..., 4], wanted, reduction="none")
    total = objects[judged].sum()
    if len(which):
        total = total + _BOX_WEIGHT * (1 - complete_iou(guesses[at], own[:, 2:6])).sum()
        labels = functional.one_hot(own[:, 1].long(), head.raw.shape[-1] - 5).float()
        named = functional.binary_cross_entropy_with_logits(head.raw[at][:, 5:], labels, reduction="sum")
        total = total + _CLASS_WEIGHT * named
    return total / max(1, len(boxes))


def _decode(head: Head) -> Tensor:
    """The guesses as left, top, right, bottom in pixels."""
    rows, columns = head.raw.shape[2:4]
    down, across = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
    cells = torch.stack([across, down], dim=-1)
    middle = (head.raw[..., :2].sigmoid() + cells) * head.stride_px
    half = head.raw[..., 2:4].clamp(max=6).exp() * head.anchors_px[:, None, None] / 2
    return torch.cat([middle - half, middle + half], dim=-1)


def _nearly_right(guesses: Tensor, boxes: Tensor) -> Tensor:
    """Which guesses overlap some box of their photo well."""
    nearly = torch.zeros(guesses.shape[:-1], dtype=torch.bool)
    for photo in range(len(guesses)):
        for box in boxes[boxes[:, 0] == photo, 2:6]:
            nearly[photo] |= _iou(guesses[photo], box) > _NEARLY_RIGHT
    return nearly


def _iou(a: Tensor, b: Tensor) -> Tensor:
    shared = (torch.minimum(a[..., 2:], b[..., 2:]) - torch.maximum(a[..., :2], b[..., :2])).clamp(min=0)
    both = shared.prod(-1)
    areas = (a[..., 2:] - a[..., :2]).prod(-1) + (b[..., 2:] - b[..., :2]).prod(-1)
    return both / (areas - both + 1e-9)


def complete_iou(a: Tensor, b: Tensor) -> Tensor:
    """Overlap, less the distance of the middles and the difference of the shapes (Zheng et al., 2020)."""
    iou = _iou(a, b)
    size_a, size_b = a[..., 2:] - a[..., :2], b[..., 2:] - b[..., :2]
    hull = torch.maximum(a[..., 2:], b[..., 2:]) - torch.minimum(a[..., :2], b[..., :2])
    apart = ((a[..., :2] + a[..., 2:] - b[..., :2] - b[..., 2:]) / 2).square().sum(-1)
    slant_a = torch.atan(size_a[..., 0] / size_a[..., 1].clamp(min=1e-6))
    slant_b = torch.atan(size_b[..., 0] / size_b[..., 1].clamp(min=1e-6))
    shape = 4 / math.pi**2 * (slant_a - slant_b).square()
    weight = (shape / (1 - iou + shape + 1e-9)).detach()
    return iou - apart / (hull.square().sum(-1) + 1e-9) - weight * shape
