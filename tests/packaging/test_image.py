"""Images: the same from the same, whoever makes them, and complete."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

from upwash.config.daemon import read_daemon_config
from upwash.errors import UsageError
from upwash.missions.bundled import load_service_alone
from upwash.packaging import contents
from upwash.packaging.base import lay_base, lay_init
from upwash.packaging.contents import copy_distributions, copy_program, copy_setting, extra_of
from upwash.packaging.image import Recipe, package, write_packed
from upwash.packaging.shipping import find_service
from upwash.real.instances.containers import HeldImage, newest_images


@pytest.fixture
def base_of_the_host(tmp_path: Path) -> Path:
    """A folder with the host's base in it."""
    root = tmp_path / "base"
    root.mkdir()
    try:
        lay_base("host", root)
        lay_init("host", root)
    except UsageError as why:
        pytest.skip(str(why))
    return root


@pytest.mark.sandbox
@pytest.mark.usefixtures("base_of_the_host")
def test_the_same_service_makes_the_same_file_and_another_another(services: Path, tmp_path: Path) -> None:
    def made(folder: str, umask: int, cls: str = "Workbench") -> Path:
        before = os.umask(umask)
        try:
            recipe = Recipe(load_service_alone(f"{services}:{cls}"))
            return package(recipe, tmp_path / folder, report=lambda _: None)
        finally:
            os.umask(before)

    first, again, other = made("a", 0o022), made("b", 0o077), made("c", 0o022, "Vandal")
    assert first.name == again.name
    assert first.read_bytes() == again.read_bytes()
    assert other.name != first.name


@pytest.mark.sandbox
@pytest.mark.usefixtures("base_of_the_host")
def test_an_image_says_what_it_holds_and_belongs_to_root(services: Path, tmp_path: Path) -> None:
    recipe = Recipe(load_service_alone(f"{services}:Workbench"), requirements=("cryptography",))
    with tarfile.open(package(recipe, tmp_path, report=lambda _: None)) as image:
        metadata = image.extractfile("metadata.yaml")
        assert metadata is not None
        properties = json.load(metadata)["properties"]
        entries = {entry.name: entry for entry in image}
    assert properties["upwash.service"] == "workbench"
    assert properties["upwash.program"] == "/opt/upwash/program/services_for_tests.py:Workbench"
    assert {(entry.uid, entry.gid, entry.uname) for entry in entries.values()} == {(0, 0, "")}
    assert entries["rootfs/sbin/init"].mode & 0o777 == 0o755
    for needed in ("grpc", "msgspec", "cryptography", "cffi", "upwash"):
        assert f"rootfs/opt/upwash/lib/{needed}/__init__.py" in entries
    assert not any(name.endswith(".key") for name in entries)


def test_what_was_copied_is_enough_to_import_an_instance(services: Path, tmp_path: Path) -> None:
    program = copy_program(f"{services}:Workbench", tmp_path)
    copy_distributions((), tmp_path)
    script = (
        "import upwash.real.instances.instance, upwash.real.instances.lxd.init\n"
        "from upwash.rpc.service import load_service; "
        f"load_service({str(tmp_path) + program!r})"
    )
    subprocess.run(
        [
            sys.executable,
            "-I",
            "-S",
            "-c",
            f"import sys; sys.path.insert(0, {str(tmp_path / 'opt/upwash/lib')!r}); {script}",
        ],
        check=True,
    )


def test_a_service_of_upwashs_own_brings_what_its_extra_requires() -> None:
    assert any(requirement.startswith("numpy") for requirement in extra_of("detector", "docker"))
    assert extra_of("workbench", "docker") == []


def test_what_cannot_be_packaged_is_named(services: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no_such_distribution is not installed here"):
        copy_distributions(("no_such_distribution",), tmp_path)
    with pytest.raises(UsageError, match="no_such_module cannot be packaged"):
        copy_program("no_such_module:Service", tmp_path)
    with pytest.raises(UsageError, match="models: no such file"):
        copy_program(f"{services}:Workbench", tmp_path, beside=[tmp_path / "models"])


def test_a_model_in_onnx_is_packed_with_its_numbers(tmp_path: Path) -> None:
    model, numbers = tmp_path / "model.onnx", tmp_path / "model.onnx.data"
    for content in ("1", "2"):
        model.write_text("a graph")
        numbers.write_text(content)
        copied = tmp_path / "root" / copy_setting(model, tmp_path / "root").relative_to("/")
        assert copied.read_text() == "a graph"
        assert copied.with_name("model.onnx.data").read_text() == content


def refused(folder: Path) -> str:
    with pytest.raises(UsageError) as refusal:
        copy_setting(folder, folder.parent / "root")
    return str(refusal.value)


def test_a_folder_is_packed_only_if_nothing_in_it_leads_elsewhere(tmp_path: Path) -> None:
    folder, secret = tmp_path / "models", tmp_path / "secret"
    folder.mkdir()
    secret.write_text("a key")
    (folder / "weights").write_text("1 2 3")
    (folder / "latest").symlink_to("weights")
    copied = tmp_path / "root" / copy_setting(folder, tmp_path / "root").relative_to("/")
    assert sorted(path.read_text() for path in copied.iterdir()) == ["1 2 3"] * 2

    odd = folder / "odd"
    for target in (secret, tmp_path, Path("/etc"), Path(), Path("/dev/zero"), Path("missing")):
        odd.symlink_to(target)
        assert str(odd) in refused(folder)
        odd.unlink()
    os.mkfifo(odd)
    assert refused(folder) == f"{odd} is not a file or folder: remove it"
    odd.unlink()
    (folder / "\x1b[2J").touch()
    assert "cannot be shown" in refused(folder)


def test_a_folder_that_is_too_large_is_refused_before_it_is_copied(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "models"
    folder.mkdir()
    with (folder / "sparse").open("wb") as sparse:
        sparse.truncate(2**40)
    assert "more than 100000 files or 32 GiB" in refused(folder)
    (folder / "sparse").unlink()
    monkeypatch.setattr(contents, "_MOST_FILES", 10)
    for number in range(11):
        (folder / str(number)).touch()
    assert "more than 10 files" in refused(folder)
    assert not (tmp_path / "root").exists()


def test_two_files_of_one_name_beside_a_program_are_refused(services: Path, tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "table").touch()
    with pytest.raises(UsageError, match="another file beside the program has that name"):
        copy_program(
            f"{services}:Workbench", tmp_path / "root", beside=[tmp_path / "a/table", tmp_path / "b/table"]
        )


def test_links_and_rights_survive_the_archive_and_times_do_not(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "program").write_text("#!/bin/sh\n")
    (folder / "program").chmod(0o700)
    (folder / "link").symlink_to("program")
    write_packed(folder, tmp_path / "a")
    os.utime(folder / "program", (1, 1))
    write_packed(folder, tmp_path / "b")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    with tarfile.open(tmp_path / "a") as archive:
        assert archive.getmember("program").mode == 0o755
        assert archive.getmember("link").linkname == "program"


@pytest.mark.sandbox
@pytest.mark.usefixtures("base_of_the_host")
def test_settings_go_into_the_image_with_the_files_that_they_name(tmp_path: Path) -> None:
    program = tmp_path / "here" / "reader.py"
    program.parent.mkdir()
    program.write_text(
        "from pathlib import Path\n"
        "from upwash import service\n"
        "@service(concurrency=3)\n"
        "class Reader:\n"
        "    def __init__(self, model: Path, threads: int = 2) -> None: ...\n"
        "    def read(self) -> None: ...\n"
    )
    (tmp_path / "here" / "weights").write_bytes(b"a model")
    config = tmp_path / "server.toml"
    config.write_text(
        'listen = "127.0.0.1:0"\nallow_without_certificates = true\n'
        '[[service]]\nname = "reader"\nprogram = "here/reader.py:Reader"\n'
        'settings = { model = "here/weights", threads = 3 }\n[[server]]\nname = "s1"\n'
    )
    recipe = Recipe(find_service("reader", read_daemon_config(config)))
    with tarfile.open(package(recipe, tmp_path / "images", report=lambda _: None)) as image:
        metadata = image.extractfile("metadata.yaml")
        assert metadata is not None
        said = HeldImage("f00", json.load(metadata)["properties"], "2026")
        found = newest_images([said])["reader"]
        packed = found.program
        model = str(packed.settings["model"])
        carried = image.extractfile(f"rootfs{model}")
        assert carried is not None and carried.read() == b"a model"
    assert packed.path == "/opt/upwash/program/reader.py:Reader"
    assert packed.settings == {"model": model, "threads": 3}
    assert found.concurrency == 3


@pytest.fixture
def fieldlib(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A distribution as pip installs one, and its metadata's folder."""
    library = tmp_path / "site-packages"
    metadata = library / "fieldlib-0.1.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: fieldlib\nVersion: 0.1\n")
    (metadata / "RECORD").write_text(
        "fieldlib.py,,\n../../bin/fieldlib,,\n__pycache__/fieldlib.cpython-311.pyc,,\n"
    )
    (library / "fieldlib.py").write_text("def brightness(photo): return len(photo)\n")
    monkeypatch.syspath_prepend(library)
    return metadata


def test_a_distribution_is_copied_whole(fieldlib: Path, tmp_path: Path) -> None:
    assert "fieldlib 0.1" in copy_distributions(["fieldlib"], tmp_path / "root")
    assert (tmp_path / "root/opt/upwash/lib/fieldlib.py").exists()


def test_an_editable_installation_is_refused_with_the_command_that_installs_it(
    fieldlib: Path, tmp_path: Path
) -> None:
    (fieldlib / "direct_url.json").write_text(
        '{"dir_info": {"editable": true}, "url": "file:///home/op/field%20lib"}'
    )
    with pytest.raises(
        UsageError, match=r"editable .*`pip install --force-reinstall --no-deps '/home/op/field lib'`"
    ):
        copy_distributions(["fieldlib"], tmp_path / "root")


def test_a_folder_that_was_installed_once_is_copied(fieldlib: Path, tmp_path: Path) -> None:
    (fieldlib / "direct_url.json").write_text('{"dir_info": {}, "url": "file:///home/op/fieldlib"}')
    assert "fieldlib 0.1" in copy_distributions(["fieldlib"], tmp_path / "root")


def test_a_distribution_without_a_list_of_its_files_is_refused(fieldlib: Path, tmp_path: Path) -> None:
    (fieldlib / "RECORD").unlink()
    with pytest.raises(
        UsageError, match=r"fieldlib has no list of its files.*--ignore-installed fieldlib==0\.1"
    ):
        copy_distributions(["fieldlib"], tmp_path / "root")


def test_a_distribution_that_lacks_a_file_is_refused(fieldlib: Path, tmp_path: Path) -> None:
    fieldlib.with_name("fieldlib.py").unlink()
    with pytest.raises(
        UsageError, match=r"fieldlib\.py of fieldlib is missing: `pip install --force-reinstall"
    ):
        copy_distributions(["fieldlib"], tmp_path / "root")


@pytest.mark.parametrize("statement", ["import helper_for_tests", "from helper_for_tests import labels"])
def test_a_file_that_the_program_imports_is_not_left_out_of_the_image(tmp_path: Path, statement: str) -> None:
    helper, program = tmp_path / "helper_for_tests.py", tmp_path / "program_for_tests.py"
    helper.write_text("labels = []\n")
    program.write_text(f"import json\ndef find():\n    {statement}\n")
    with pytest.raises(UsageError, match=r"imports .*: pack it too, with --include .*helper_for_tests\.py"):
        copy_program(f"{program}:find", tmp_path / "root")
    copy_program(f"{program}:find", tmp_path / "root", beside=[helper])


def test_a_file_beside_that_python_does_not_find_first_may_be_left_out(tmp_path: Path) -> None:
    (tmp_path / "json.py").touch()
    program = tmp_path / "program_for_tests.py"
    program.write_text("import json\n")
    assert copy_program(f"{program}:find", tmp_path / "root")
