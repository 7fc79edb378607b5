"""Why a provider of onnxruntime cannot be used, in onnxruntime's own words, and what is used instead."""

from __future__ import annotations

import errno
import os
import sys
from pathlib import Path

import onnxruntime
import pytest

from upwash.errors import ModelError, UsageError
from upwash.services.provider import open_session

# What onnxruntime-gpu 1.31.1 printed where CUDA's libraries are not installed.
MISSING_LIBRARY = (
    "\x1b[1;31m2026-01-25 22:38:12.372934275 [E:onnxruntime:Default, provider_bridge_ort.cc:2458 operator()] "
    "/onnxruntime_src/onnxruntime/core/session/provider_bridge_ort.cc:2043 onnxruntime::Provider& "
    "onnxruntime::ProviderLibrary::Get() [ONNXRuntimeError] : 1 : FAIL : Failed to load library "
    "/opt/libonnxruntime_providers_cuda.so with error: libcublasLt.so.13: cannot open shared object file: "
    "No such file or directory\n\x1b[m\n\x1b[0;93m2026-01-25 22:38:12.372990982 [W:onnxruntime:Default, "
    "onnxruntime_pybind_state.cc:1295 CreateExecutionProviderFactoryInstance] Failed to create "
    "CUDAExecutionProvider. Require cuDNN 9.* and CUDA 13.*. Please install all dependencies.\x1b[m\n"
)
# What it raises where CUDA is there, and the driver is not.
OLD_DRIVER = (
    "/onnxruntime_src/onnxruntime/core/providers/cuda/cuda_call.cc:129 std::conditional_t<THRW, void, Status> "
    "onnxruntime::CudaCall(ERRTYPE, const char*) [with ERRTYPE = cudaError; bool THRW = true] CUDA failure 35: CUDA "
    "driver version is insufficient for CUDA runtime version ; GPU=-1 ; hostname=vm ; "
    "file=/onnxruntime_src/onnxruntime/core/providers/cuda/cuda_execution_provider.cc ; line=355 ; "
    "expr=cudaSetDevice(info_.device_id);"
)

# Of a card that is too old, when a network is run.
NO_KERNEL = (
    "[ONNXRuntimeError] : 1 : FAIL : Non-zero status code returned while running Conv node. Name:'conv0' Status "
    "Message: CUDA error cudaErrorNoKernelImageForDevice:no kernel image is available for execution on the device"
)


class Session:
    """A session as onnxruntime makes one where CUDA is installed in part."""

    printed = ""
    raised = ""
    broken = False
    fails_on: tuple[str, ...] = ()

    def __init__(
        self,
        model: str,
        _: object,
        *,
        providers: list[str],
        provider_options: list[dict[str, str]],
        enable_fallback: bool,
    ) -> None:
        assert not enable_fallback  # it would print why, and raise nothing
        if self.broken or (self.raised and "CUDAExecutionProvider" in providers):
            raise RuntimeError(self.raised or "no protobuf")
        os.write(2, self.printed.encode())
        self.provider = providers[0] if self.fails_on else "CPUExecutionProvider"

    def get_providers(self) -> list[str]:
        return [self.provider]

    def get_inputs(self) -> list[onnxruntime.NodeArg]:
        return []

    get_outputs = get_inputs

    def run(self, *_: object) -> None:
        if self.provider in self.fails_on:
            raise RuntimeError(NO_KERNEL)


@pytest.fixture
def session(monkeypatch: pytest.MonkeyPatch) -> type[Session]:
    made = type("Session", (Session,), {})
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: ["CUDAExecutionProvider"])
    monkeypatch.setattr(onnxruntime, "InferenceSession", made)
    monkeypatch.setattr("upwash.services.provider._DEVICES", ("/dev/null",))
    return made


def refusal() -> str:
    with pytest.raises(UsageError) as raised:
        open_session(Path("model.onnx"), threads=1, provider="cuda")
    return str(raised.value)


def test_a_library_that_is_missing_is_in_the_message_and_still_printed(
    session: type[Session], capfd: pytest.CaptureFixture[str]
) -> None:
    session.printed = MISSING_LIBRARY
    assert refusal() == (
        'provider = "cuda" cannot be used here: Failed to load library /opt/libonnxruntime_providers_cuda.so with '
        "error: libcublasLt.so.13: cannot open shared object file: No such file or directory Failed to create "
        "CUDAExecutionProvider. Require cuDNN 9.* and CUDA 13.*. Please install all dependencies.; install what it "
        'names, and show the card to a service in a sandbox (`devices`), or say provider = "cpu"'
    )
    assert capfd.readouterr().err == MISSING_LIBRARY


def test_a_card_that_nobody_asked_for_and_that_fails_is_told_and_the_processor_computes(
    session: type[Session], capfd: pytest.CaptureFixture[str]
) -> None:
    session.printed = MISSING_LIBRARY
    found = open_session(Path("model.onnx"), threads=1, provider="auto")
    assert found.get_providers() == ["CPUExecutionProvider"]
    line, again = capfd.readouterr().err.split("\n", 1)
    assert line.startswith('warning: provider = "cuda" cannot be used here: Failed to load library /opt/')
    assert line.endswith("; the detector computes on the processor")
    assert again == MISSING_LIBRARY, "of the session on the processor alone"


def test_a_card_that_runs_no_network_is_refused_before_the_first_photo(session: type[Session]) -> None:
    session.fails_on = ("CUDAExecutionProvider",)
    assert "no kernel image is available for execution on the device; install what it names" in refusal()
    assert open_session(Path("model.onnx"), threads=1, provider="auto").get_providers() == [
        "CPUExecutionProvider"
    ]


def test_without_a_card_nothing_of_cuda_is_loaded(
    session: type[Session], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("upwash.services.provider._DEVICES", ("/dev/none",))
    monkeypatch.setattr(onnxruntime, "preload_dlls", lambda: pytest.fail("it loads CUDA"))
    found = open_session(Path("model.onnx"), threads=1, provider="auto")
    assert found.get_providers() == ["CPUExecutionProvider"]
    assert "warning: no graphics card is shown to this process" in capfd.readouterr().err


def test_a_network_that_runs_nowhere_is_not_the_cards_fault(session: type[Session]) -> None:
    session.fails_on = ("CUDAExecutionProvider", "CPUExecutionProvider")
    assert open_session(Path("model.onnx"), threads=1, provider="cuda").get_providers() == [
        "CUDAExecutionProvider"
    ]


def test_without_a_library_for_cards_nothing_is_said(
    session: type[Session], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: ["CPUExecutionProvider"])
    open_session(Path("model.onnx"), threads=1, provider="auto")
    assert capfd.readouterr().err == ""


def test_libraries_beside_onnxruntime_are_loaded_before_it_looks_for_them(
    session: type[Session], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def load() -> None:
        sys.stdout.write("Failed to load libcufft.so.12: no such file\n")
        session.raised = OLD_DRIVER  # what it says of the first library that is missing

    session.printed = MISSING_LIBRARY
    monkeypatch.setattr(onnxruntime, "preload_dlls", load)
    assert "CUDA failure 35" in refusal()
    assert capfd.readouterr().out == ""


def test_a_sandbox_in_which_memory_has_files_hides_no_reason(
    session: type[Session], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: str) -> int:
        raise OSError(errno.ENOSYS, "Function not implemented")

    monkeypatch.setattr(os, "memfd_create", refuse)
    session.printed = MISSING_LIBRARY
    assert "libcublasLt.so.13: cannot open shared object file" in refusal()


def test_an_error_of_cuda_is_in_the_message_with_its_number(session: type[Session]) -> None:
    session.raised = OLD_DRIVER
    said = refusal()
    assert (
        "here: CUDA failure 35: CUDA driver version is insufficient for CUDA runtime version; install" in said
    )


def test_a_provider_that_gives_no_reason_is_told_as_that(session: type[Session]) -> None:
    assert "cannot be used here: onnxruntime does not say why" in refusal()


def test_a_model_that_no_provider_loads_is_the_models_error(session: type[Session]) -> None:
    session.broken = True
    with pytest.raises(ModelError, match=r"model\.onnx: onnxruntime cannot load it \(no protobuf\)"):
        open_session(Path("model.onnx"), threads=1, provider="cuda")


def test_a_reason_without_end_is_cut(session: type[Session]) -> None:
    """It would take hours, and so exceed the time of a test, if each letter might begin a place in a source."""
    session.raised = "x" * 3_000_000
    assert len(refusal()) < 1300
