"""What is imported by name: missions and services (`package.module:Name`, `path/to/file.py:Name`), optional parts."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

from upwash.errors import UsageError


def load(program: str) -> object:
    """The object of that path; raises UsageError saying what is missing. Runs the module or file."""
    module_path, _, name = program.rpartition(":")
    if not module_path or not name:
        raise UsageError(f"{program!r}: write it as package.module:Name or path/to/file.py:Name")
    try:
        with _no_bytecode():
            module = _load_file(Path(module_path)) if module_path.endswith(".py") else _import(module_path)
    except (Exception, SystemExit) as error:
        raise UsageError(
            f"{program!r} cannot be loaded from {module_path}: {type(error).__name__}: {error}"
        ) from error
    if not hasattr(module, name):
        raise UsageError(f"{program!r}: there is no {name} in {module_path}")
    return getattr(module, name)


@contextlib.contextmanager
def _no_bytecode() -> Iterator[None]:
    """Imports without leaving compiled files: a full disk may cut one short, and no later flight could load it.

    Pythons before 3.12.8 and 3.13.1 keep such a file: CPython issue 126606.
    """
    before = sys.dont_write_bytecode
    sys.dont_write_bytecode = True
    try:
        yield
    finally:
        sys.dont_write_bytecode = before


def _import(name: str) -> ModuleType:
    return importlib.import_module(name)


def _load_file(path: Path) -> ModuleType:
    path = path.resolve()
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))  # the file may import its neighbours
    found = importlib.util.find_spec(path.stem)
    if found is not None and found.origin == str(path):
        return importlib.import_module(
            path.stem
        )  # one module, however it is named, or its exceptions would be two
    name = f"upwash_program_{path.stem}"  # it has the name of another module; the same in every process
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
    """Imports what `pip install 'upwash[name]'` brings; raises UsageError where it was not done."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise UsageError(
            f"{error.name} is not installed: `pip install 'upwash[{name}]'` installs it"
        ) from error
    except ImportError as error:  # it is there, and broken
        raise UsageError(
            f"what `pip install 'upwash[{name}]'` installs cannot be imported: {error}"
        ) from error
