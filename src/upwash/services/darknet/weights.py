"""A Darknet weights file: a header, then the numbers of each convolution in the order of the cfg."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.errors import ModelError
from upwash.services.darknet.layers import Convolutional, DarknetNetwork, Layer

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float32]

_FLOAT_BYTES = 4
_VERSION_BYTES = 12  # major, minor, revision
_BATCH_NORM_EPSILON = 1e-6  # added to the root, not under it


@dataclass(frozen=True, slots=True)
class Parameters:
    """The parameters of a convolution, with its batch norm folded in."""

    weights: Floats  # filters, channels in a group, size, size
    biases: Floats  # filters

    def plain(self) -> bytes:
        """The weights, then the biases, as little-endian floats."""
        return b"".join(array.astype("<f4", copy=False).tobytes() for array in (self.weights, self.biases))


class WeightsFile:
    """The weights of a network, read convolution by convolution to save memory."""

    def __init__(self, file: Path, network: DarknetNetwork) -> None:
        """Raise ModelError, with layer and offset, if the length of the file does not fit the network."""
        import numpy as np

        self._file = file
        self._layers = [layer for layer in network.layers if isinstance(layer.operator, Convolutional)]
        self._content = np.memmap(file, np.uint8, "r") if file.stat().st_size else np.empty(0, np.uint8)
        self._start = self._header_bytes()
        self._require_length()

    def parameters(self) -> Iterator[Parameters]:
        """The parameters of each convolution in turn; raises ModelError for values that are no numbers."""
        at = self._start
        for layer in self._layers:
            yield self._fold(layer, at)
            at += _needed_bytes(layer)

    def _header_bytes(self) -> int:
        import numpy as np

        if len(self._content) < _VERSION_BYTES:
            raise ModelError(self._file, "offset 0", f"{len(self._content)} bytes hold no header")
        major, minor, _ = (int(number) for number in self._content[:_VERSION_BYTES].view(np.dtype("<i4")))
        if not (0 <= major < 1000 and 0 <= minor < 1000):
            raise ModelError(
                self._file, "offset 0", f"version {major}.{minor} is none: this is no Darknet weights file"
            )
        return _VERSION_BYTES + (8 if 10 * major + minor >= 2 else 4)  # then the number of training pictures

    def _require_length(self) -> None:
        found, at = len(self._content), self._start
        total = at + sum(map(_needed_bytes, self._layers))
        for layer in self._layers:
            end = at + _needed_bytes(layer)
            if found < end:
                raise ModelError(
                    self._file,
                    f"{layer.where}, offset {at}",
                    f"the file ends at {found}; the layer needs {end - at} bytes, the network {total} in all: "
                    "the file is cut off, or belongs to another cfg",
                )
            at = end
        if found > at:
            raise ModelError(
                self._file,
                f"offset {at}",
                f"{found - at} bytes are left after the last layer; the network needs {total} in all: the file "
                "belongs to another cfg",
            )

    def _fold(self, layer: Layer, at: int) -> Parameters:
        import numpy as np

        convolution = layer.operator
        assert isinstance(convolution, Convolutional)  # noqa: S101 - only these have weights
        numbers = self._content[at : at + _needed_bytes(layer)].view(np.dtype("<f4"))
        bad = np.flatnonzero(~np.isfinite(numbers))
        if bad.size:
            raise ModelError(
                self._file,
                f"{layer.where}, offset {at + _FLOAT_BYTES * int(bad[0])}",
                f"{numbers[bad[0]]} is not a number to compute with: the file is damaged, or its training failed",
            )
        filters = convolution.filters
        vectors = [numbers[index * filters : (index + 1) * filters] for index in range(_vectors(convolution))]
        shape = (filters, layer.input.channels // convolution.groups, convolution.size, convolution.size)
        weights = numbers[len(vectors) * filters :].reshape(shape)
        if not convolution.batch_normalize:
            return Parameters(np.array(weights), np.array(vectors[0]))
        biases, scales, means, variances = (vector.astype(np.float64) for vector in vectors)
        if (variances < 0).any():
            raise ModelError(
                self._file,
                f"{layer.where}, offset {at + _FLOAT_BYTES * (3 * filters + int(np.argmin(variances)))}",
                f"a variance of {variances.min():g}: the file is damaged, or belongs to another cfg",
            )
        factors = scales / (np.sqrt(variances) + _BATCH_NORM_EPSILON)
        with np.errstate(over="ignore", invalid="ignore"):
            folded = Parameters(
                weights * factors.astype(np.float32)[:, np.newaxis, np.newaxis, np.newaxis],
                (biases - means * factors).astype(np.float32),
            )
        if not (np.isfinite(folded.weights).all() and np.isfinite(folded.biases).all()):
            raise ModelError(
                self._file,
                f"{layer.where}, offset {at}",
                "its numbers are too large to compute with: the file is damaged, or belongs to another cfg",
            )
        return folded


def _vectors(convolution: Convolutional) -> int:
    """The count of numbers per filter before the weights: biases, and three more for a batch norm."""
    return 4 if convolution.batch_normalize else 1


def _needed_bytes(layer: Layer) -> int:
    convolution = layer.operator
    assert isinstance(convolution, Convolutional)  # noqa: S101 - only these have weights
    per_filter = _vectors(convolution) + layer.input.channels // convolution.groups * convolution.size**2
    return _FLOAT_BYTES * convolution.filters * per_filter
