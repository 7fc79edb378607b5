"""Imports by name: missions and services (`package.module:Name`, `path/to/file.py:Name`), and optional parts."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import shlex
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

from upwash.errors import UsageError
from upwash.support.text import worded

_UV_RECEIPT = "uv-receipt.toml"  # of a tool that uv installed


def load(program: str) -> object:
    """The object of that path; raises UsageError saying what is missing. Runs the module or file."""
    module_path, _, name = program.rpartition(":")
    if not module_path or not name:
        raise UsageError(f"{program!r}: write it as package.module:Name or path/to/file.py:Name")
    try:
        with _no_bytecode():
            is_file = module_path.endswith(".py")
            module = _load_file(Path(module_path)) if is_file else importlib.import_module(module_path)
    except (Exception, SystemExit) as error:
        raise UsageError(
            f"{program!r} cannot be loaded from {module_path}: {worded(error)}"
            f"{import_remedy(error, module_path)}"
        ) from error
    if not hasattr(module, name):
        raise UsageError(f"{program!r}: there is no {name} in {module_path}")
    return getattr(module, name)


def import_remedy(error: BaseException, place: str) -> str:
    """The remedy for a failed import in the module or file at that place, after a semicolon; "" if unknown."""
    if isinstance(error, AttributeError):
        wanted = getattr(error.obj, "__name__", "") if isinstance(error.obj, ModuleType) else ""
    else:
        wanted = (error.name or "") if isinstance(error, ImportError) else ""
    if not place.endswith(".py"):
        is_missing = isinstance(error, ModuleNotFoundError) and wanted == place.partition(".")[0]
        return (
            "; set PYTHONPATH to the folder that has it, or write path/to/file.py:Name" if is_missing else ""
        )
    file = Path(place).resolve()
    if "relative import" in str(error) and file.with_name("__init__.py").exists():
        return (
            f"; it belongs to a package: write {file.parent.name}.{file.stem}:Name, and set "
            f"PYTHONPATH={shlex.quote(str(file.parents[1]))}"
        )
    beside, found = file.with_name(f"{wanted}.py"), getattr(sys.modules.get(wanted), "__file__", None)
    if not wanted or not beside.exists() or found == str(beside):
        return ""
    return f"; {beside} has the name of a module that Python finds first ({found or 'built in'}): rename the file"


def module_command(module: str, *arguments: str) -> list[str]:
    """The command that runs a module in this program's Python.

    `python -m` alone looks first in the folder where it is started, and a `queue.py` there hides Python's own.
    """
    return [sys.executable, "-P", "-m", module, *arguments]


def look_here() -> None:
    """Search the folder where this program is started for modules too, last."""
    with contextlib.suppress(OSError):  # the folder is gone
        sys.path.append(str(Path.cwd()))


@contextlib.contextmanager
def _no_bytecode() -> Iterator[None]:
    """Imports without leaving compiled files: a full disk may cut one short, and no later flight could load it.

    Pythons before 3.12.8 and 3.13.1 keep a file that was cut short: CPython issue 126606.
    """
    before = sys.dont_write_bytecode
    sys.dont_write_bytecode = True
    try:
        yield
    finally:
        sys.dont_write_bytecode = before


def _load_file(path: Path) -> ModuleType:
    path = path.resolve()
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))  # the file may import its neighbours
    found = None if "." in path.stem else importlib.util.find_spec(path.stem)
    if found is not None and found.origin == str(path):
        return importlib.import_module(path.stem)  # a second module would have exception classes of its own
    # The file has the name of another module, or a name that cannot be imported. In every process the same:
    name = f"upwash_program_{path.stem.replace('.', '_')}"
    loaded = sys.modules.get(name)
    if loaded is not None and loaded.__file__ == str(path):
        return loaded  # a mission and its service may share a file
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


@contextlib.contextmanager
def extra(name: str) -> Iterator[None]:
    """Import what an extra of upwash installs; raises UsageError without it."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise UsageError(f"{error.name} is not installed: `{install_extra(name)}` installs it") from error
    except ImportError as error:  # it is there, and broken
        raise UsageError(f"what `{install_extra(name)}` installs cannot be imported: {error}") from error


def install_extra(name: str) -> str:
    """The command that adds an extra of upwash where it is installed."""
    receipt = Path(sys.prefix, _UV_RECEIPT)
    if not receipt.exists():
        return pip(f"install 'upwash[{name}]'")
    with contextlib.suppress(
        OSError, ValueError, LookupError
    ):  # uv installs only the extras that the command names
        asked = tomllib.loads(receipt.read_text())["tool"]["requirements"]
        had = [extra for each in asked if each["name"] == "upwash" for extra in each.get("extras", [])]
        name = ",".join(dict.fromkeys([*had, name]))
    return f"uv tool install 'upwash[{name}]'"


def pip(words: str) -> str:
    """The command that has pip do this where upwash is installed: by `uv tool`, pipx or pip itself."""
    if Path(sys.prefix, _UV_RECEIPT).exists():
        verb, _, rest = words.partition(" ")
        return f"uv pip {verb} --python {shlex.quote(sys.prefix)} {rest}"
    if Path(sys.prefix, "pipx_metadata.json").exists():
        return f"pipx runpip upwash {words}"
    return f"pip {words}"
