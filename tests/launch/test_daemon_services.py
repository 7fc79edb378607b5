"""Services whose code is looked at again: a version that cannot be loaded leaves the former one, and says why."""

from __future__ import annotations

from pathlib import Path

import pytest

from upwash.config.daemon import DaemonConfig, read_daemon_config
from upwash.errors import UsageError
from upwash.launch import daemon_services
from upwash.launch.confinement import Confinement
from upwash.launch.daemon_services import DaemonServices

CONFIG = """
listen = "unix:daemon.sock"
allow_without_certificates = true
start_timeout_s = {within_s}
[runtime]
sandbox = "off"
[[service]]
name = "level"
program = "level.py:Level"
[[service]]
name = "scale"
program = "other/scale.py:Scale"
[[server]]
name = "s1"
"""
SERVICE = """
from upwash import service
@service
class {name}:
    def read(self) -> int:
        return 1
"""
MORE = """
    def tare(self) -> int:
        return 0
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "other").mkdir()
    (tmp_path / "level.py").write_text(SERVICE.format(name="Level"))
    (tmp_path / "other/scale.py").write_text(SERVICE.format(name="Scale"))
    return tmp_path


def read(folder: Path, *, within_s: float = 60.0) -> DaemonConfig:
    file = folder / "server.toml"
    file.write_text(CONFIG.format(within_s=within_s))
    return read_daemon_config(file)


async def test_new_methods_of_code_that_prints_are_known(folder: Path) -> None:
    services = await DaemonServices.found(read(folder), Confinement())
    (folder / "level.py").write_text("print('hello')" + SERVICE.format(name="Level") + MORE)
    images = (await services.anew(read(folder))).images
    assert images["level"].methods == {"read", "tare"}
    assert images["level"].version != services.images["level"].version
    assert images["scale"] == services.images["scale"]


@pytest.mark.parametrize(
    ("code", "within_s", "why"),
    [
        ("import nosuchmodule", 60.0, "No module named 'nosuchmodule'"),
        (SERVICE.format(name="Other"), 60.0, "there is no Level"),
        ("import os; os._exit(7)", 60.0, "the process that loads it ended with code 7"),
        ("import time; time.sleep(600)", 5.0, "level is not loaded within 5 s"),
    ],
)
async def test_code_that_cannot_be_loaded_leaves_its_service_alone(
    folder: Path, code: str, within_s: float, why: str
) -> None:
    services = await DaemonServices.found(read(folder), Confinement())
    (folder / "level.py").write_text(code)
    (folder / "other/scale.py").write_text(SERVICE.format(name="Scale") + MORE)
    found = await services.anew(read(folder, within_s=within_s))
    assert found.images["level"] == services.images["level"]
    assert found.images["scale"].methods == {"read", "tare"}
    assert list(found.stay) == ["level"]
    assert why in found.stay["level"]


@pytest.mark.parametrize(
    ("former", "latter", "why"),
    [
        ('program = "level.py:Level"', 'program = "level.py:Other"', "there is no Other"),
        ('program = "level.py:Level"', 'program = "level.py:Level"\nsettings = { gain = 2 }', "gain"),
        ('name = "level"\nprogram = "level.py', 'name = "tare"\nprogram = "tare.py', "No such file"),
    ],
)
async def test_a_program_or_settings_that_do_not_fit_are_refused_as_they_are_named(
    folder: Path, former: str, latter: str, why: str
) -> None:
    services = await DaemonServices.found(read(folder), Confinement())
    file = folder / "server.toml"
    file.write_text(file.read_text().replace(former, latter))
    with pytest.raises(UsageError, match=why):
        await services.anew(read_daemon_config(file))


async def test_another_upwash_on_the_disk_leaves_all_services_and_names_the_signal(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    services = await DaemonServices.found(read(folder), Confinement())
    monkeypatch.setattr(daemon_services, "version_of_upwash", lambda: "another")
    (folder / "level.py").write_text(SERVICE.format(name="Level") + MORE)
    found = await services.anew(read(folder))
    assert found.images == services.images
    assert set(found.stay) == {"level", "scale"}
    assert "upwash itself has changed on the disk" in found.stay["level"]
    assert "SIGUSR2" in found.stay["level"]
