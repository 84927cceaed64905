"""The cache directory, files that are either complete or absent, and netCDF-4 files.

Behind the bytes of a netCDF-4 file stands their sha256, which HDF5 passes over: HDF5 may hang or crash on a damaged
file, so one is opened only where that is right, or where another process has read all of it in time.
"""

from __future__ import annotations

import hashlib
import os
import re
import secrets
import socket
import stat
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import platformdirs

from .arrays import Array
from .validation import InputError, file_path

if TYPE_CHECKING:
    import h5py
    import xarray as xr


CODE = {"numba": "*/*", "jax": "*.xla"}  # folders of compiled code in the cache directory, and what lies in them


@cache
def directory() -> Path:
    """STIFFBEAM_CACHE_DIR, else the platform's cache directory, else a temporary one with a warning.

    Compiled kernels are code that is run: a folder in which others can write is not used.
    """
    wanted = os.environ.get("STIFFBEAM_CACHE_DIR") or platformdirs.user_cache_dir("stiffbeam")
    path = Path(wanted)
    try:
        # For this user alone, whatever the umask: compiled code lies here.
        for folder in (path, *(path / name for name in CODE)):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _require_private(path)
        # Only writing shows that a folder can be written to.
        with tempfile.TemporaryFile(dir=path):
            return path
    except OSError as error:
        path = Path(tempfile.mkdtemp(prefix="stiffbeam-"))
        why = error if isinstance(error, _Shared) else f"cannot write to the cache directory {wanted}"
        warnings.warn(
            f"{why}: using {path} for this process; "
            "set STIFFBEAM_CACHE_DIR to a writable directory of your own to keep compiled kernels",
            stacklevel=2,
        )
        return path


class _Shared(OSError):
    """A folder into which another user may put code."""


def _require_private(folder: Path) -> None:
    """Raise an error if another user can replace compiled code in the cache directory."""
    if hasattr(os, "getuid") and _others_enter(folder):
        for name, pattern in CODE.items():
            if _others_enter(folder / name):
                for path in (folder / name).glob(pattern):
                    _others_enter(path)


def _others_enter(path: Path) -> bool:
    """Return True if another user can enter or read this place; raise an error if one owns it or can write to it."""
    status = path.stat()
    # Root can write everywhere: a folder of root's is as safe as one of this user.
    if status.st_uid not in (os.getuid(), 0) or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise _Shared(f"others can write to {path}, from which compiled code is run")
    return bool(status.st_mode & (stat.S_IRWXG | stat.S_IRWXO))


@cache
def source_hash(folder: Path = Path(__file__).parents[1]) -> str:
    """Hash of the code and data in a folder, by default the package's. It changes with every edit, so old results are
    not reused."""
    digest = hashlib.sha256()
    for file in sorted({*folder.rglob("*.py"), *folder.rglob("*.toml")}):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def forget(folder: Path, pattern: str, most: int) -> None:
    """Remove the files that match and were not used for longest, down to ``most`` bytes."""
    used = {path: path.stat() for path in folder.glob(pattern)}
    size = 0
    # The latest first, as long as they fit.
    for path, status in sorted(used.items(), key=lambda item: item[1].st_mtime, reverse=True):
        size += status.st_size
        if size > most:
            path.unlink(missing_ok=True)


PARTIAL = re.compile(r"\.(.+)\.([^.]*)-(\d+)-[0-9a-f]{8}\.partial")  # name, host and process of the one that writes


def write_whole(file: str | Path, content: str | bytes) -> Path:
    """Write ``content`` to the file, text in UTF-8. The old content stays until the new one is completely on the disk.

    Folders on the way are made, the file has the mode that the umask gives, and what a killed process of this
    machine left half-written for the same file goes. Raises InputError for a place that cannot be written to, and
    where there is no room.
    """
    path = file_path("file", file)
    data = content.encode("utf-8") if isinstance(content, str) else content
    # A number of a process holds on one machine only, and several may share a disk.
    host = re.sub(r"[^\w]", "_", socket.gethostname())
    partial = path.parent / f".{_beginning(path.name)}.{host}-{os.getpid()}-{secrets.token_hex(4)}.partial"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_left_over(path, host)
        # A new file: "x" never opens one that is there.
        with partial.open("xb") as stream:
            stream.write(data)
            stream.flush()
            # On the disk before it takes the name: after a crash the name stands for the old content or the new.
            os.fsync(stream.fileno())
        os.replace(partial, path)
    except OSError as error:
        remedy = f"{error.strerror or error}; what was there is as it was"
        raise InputError("file", str(path), "lie in a folder that can be written to, with room", remedy) from None
    finally:
        with suppress(OSError):
            # It has its name by now, unless there was an error.
            partial.unlink()
    return path


def _beginning(name: str) -> str:
    """The first 150 bytes of a name: file systems allow 255 in all, and the rest is needed."""
    return name.encode("utf-8")[:150].decode("utf-8", errors="ignore")


def _remove_left_over(path: Path, host: str) -> None:
    for left in path.parent.glob(".*.partial"):
        match = PARTIAL.fullmatch(left.name)
        # Only what a dead process of this machine left: a living one is still writing.
        if match and match[1] == _beginning(path.name) and match[2] == host and not _lives(int(match[3])):
            left.unlink(missing_ok=True)


def _lives(process: int) -> bool:
    """Return True if a process with that number exists, or may exist."""
    if os.name == "nt":  # there the signal 0 would interrupt the process
        return True
    # Signal 0 sends nothing: it tests whether the process exists.
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # somebody else's
        return True
    return True


FORMAT_ATTRIBUTES = ("CLASS", "NAME", "REFERENCE_LIST", "DIMENSION_LIST")  # of HDF5's dimension scales
NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable.{:10d}"  # the name that netCDF-4 prescribes

SEAL = b"\nsha256 "  # before the digest of all bytes in front of it
SEAL_LENGTH = len(SEAL) + 64
READ_SECONDS = 20.0  # for another process to read a file of 100 MB that bears no seal; a damaged one may take for ever
READ_ALL = """
import sys, h5py
try:
    import resource
    resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[2]),) * 2)
except ImportError:
    pass
def read(name, item):
    dict(item.attrs)
    if isinstance(item, h5py.Dataset):
        item[()]
try:
    with h5py.File(sys.argv[1]) as file:
        read("", file)
        file.visititems(read)
except Exception as error:
    sys.exit(f"{type(error).__name__}: {error}")
"""


@dataclass(frozen=True, eq=False)
class Arrays:
    """variables: name to (dimensions, values, attributes); one that has its dimension's name is a coordinate."""

    variables: dict[str, tuple[tuple[str, ...], Array, dict[str, Any]]]
    attributes: dict[str, Any]

    def __getitem__(self, name: str) -> Array:
        return self.variables[name][1]

    def __contains__(self, name: object) -> bool:
        return name in self.variables

    def renamed(self, names: Mapping[str, str]) -> Arrays:
        """The same with other names of the variables in ``names``."""
        return Arrays({names.get(name, name): each for name, each in self.variables.items()}, self.attributes)

    def to_xarray(self) -> xr.Dataset:
        """The variables as an xarray.Dataset."""
        import xarray as xr

        coordinates, data = self._parts()
        return xr.Dataset(data, coords=coordinates, attrs=self.attributes)

    def to_dict(self) -> dict[str, Any]:
        """The variables in the layout of ``xarray.Dataset.to_dict``, which ``xarray.Dataset.from_dict`` reads."""
        coordinates, data = (
            {
                name: {"dims": dims, "attrs": attributes, "data": values}
                for name, (dims, values, attributes) in x.items()
            }
            for x in self._parts()
        )
        return {"coords": coordinates, "attrs": self.attributes, "dims": self.sizes, "data_vars": data}

    def _parts(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Coordinates, those named like their dimension or in an attribute ``coordinates``, and the other variables;
        without that attribute, which only files need."""
        named = {name for _, _, x in self.variables.values() for name in x.get("coordinates", "").split()}
        parts: tuple[dict[str, Any], dict[str, Any]] = ({}, {})
        for name, (dims, values, attributes) in self.variables.items():
            notes = {key: text for key, text in attributes.items() if key != "coordinates"}
            parts[not (dims == (name,) or name in named)][name] = (dims, values, notes)
        return parts

    def hash(self, attributes: Iterable[str]) -> str:
        """sha256 of every variable and of the named attributes."""
        digest = hashlib.sha256()
        for name in sorted(self.variables):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(self.variables[name][1]).tobytes())
        for name in sorted(attributes):
            digest.update(f"{name}={self.attributes.get(name)}".encode())
        return digest.hexdigest()

    @property
    def sizes(self) -> dict[str, int]:
        """Length of every dimension."""
        return {dim: n for dims, x, _ in self.variables.values() for dim, n in zip(dims, np.shape(x), strict=True)}


def write_netcdf(data: Arrays, file: str | Path, compression: int = 0) -> Path:
    """Write a netCDF-4 file, compressed where ``compression`` is 1 to 9: into memory, since HDF5 does not survive a
    full disk, then in one step. Raises InputError for a place that cannot be written to.

    The layout is that of the netCDF-4 format on HDF5: a dimension is a dimension scale, and names itself in every
    variable that has it.
    """
    import h5py

    packing = {"compression": "gzip", "compression_opts": compression, "shuffle": True} if compression else {}
    sizes = data.sizes
    # In memory: the file on the disk is written in one step below.
    with h5py.File(Path(file).name, "w", driver="core", backing_store=False, track_order=True) as target:
        target.attrs.update(data.attributes)
        scales: dict[str, h5py.Dataset] = {}
        # Dimensions first: variables refer to their scales. A coordinate is its own scale.
        for k, (name, size) in enumerate(sizes.items()):
            _, values, attributes = data.variables.get(name, ((), None, {}))
            unlimited = {"maxshape": (None,)} if size == 0 else {}  # what netCDF takes a length of zero for
            scale = target.create_dataset(name, (size,), ">f4" if values is None else None, values, **unlimited)
            scale.make_scale(NO_VARIABLE.format(size) if values is None else name)
            scale.attrs.update(attributes | {"_Netcdf4Dimid": np.int32(k)})
            scales[name] = scale
        # Then the variables, with their dimensions attached.
        for name, (dims, values, attributes) in data.variables.items():
            if name in sizes:
                continue
            unlimited = {"maxshape": tuple(n or None for n in np.shape(values))} if np.size(values) == 0 else {}
            stored = target.create_dataset(name, data=values, **(unlimited or (packing if dims else {})))
            for axis, dim in enumerate(dims):
                stored.dims[axis].attach_scale(scales[dim])
            stored.attrs.update(attributes)
        target.flush()
        image = target.id.get_file_image()
    return write_whole(file, image + SEAL + hashlib.sha256(image).hexdigest().encode())


def read_netcdf(file: str | Path) -> Arrays:
    """The arrays in a netCDF-4 file of one group. The file has to be whole, see ``require_whole``."""
    import h5py

    with h5py.File(file) as source:
        variables = {}
        for name, stored in source.items():
            # A dimension without values has a name that says so.
            if not _plain(stored.attrs.get("NAME", "")).startswith(NO_VARIABLE[:40]):
                scales = [axis[0].name if len(axis) else f"/{name}" for axis in stored.dims]
                variables[name] = (tuple(each.lstrip("/") for each in scales), stored[()], _notes(stored))
        return Arrays(variables, _notes(source))


def _notes(item: Any) -> dict[str, Any]:
    """Attributes of a variable or a file, without those that make up the format."""
    ours = (name for name in item.attrs if name not in FORMAT_ATTRIBUTES and not name.startswith("_N"))
    return {name: _plain(item.attrs[name]) for name in ours}


def _plain(value: Any) -> Any:
    """An array of one entry as this entry, bytes as text."""
    value = value.item() if isinstance(value, (np.ndarray, np.generic)) and value.size == 1 else value
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def require_whole(file: Path) -> None:
    """Raise InputError if a file does not match its checksum. A file without checksum must be readable to its end, by a
    separate process, within ``READ_SECONDS`` and 8 GiB."""
    content = file.read_bytes()
    # At the very end only: the same letters may stand among the data.
    body, seal, digest = content[-SEAL_LENGTH:].rpartition(SEAL)
    body = content[:-SEAL_LENGTH] + body
    if seal and hashlib.sha256(body).hexdigest().encode() == digest:
        return
    reason = "its bytes are not those that were written" if seal else _unreadable(file, len(content))
    if reason:
        raise InputError("file", str(file), "be a whole netCDF-4 file", f"it is damaged, make it again: {reason}")


def _unreadable(file: Path, size: int) -> str:
    """Reason why the file cannot be read to its end; "" if it can."""
    # -P, and PYTHONPATH below: the packages of this process, and none from the current folder.
    words = [sys.executable, "-P", "-c", READ_ALL, str(file.absolute()), str(8 * 2**30)]
    seconds = READ_SECONDS * (1.0 + size / 1e8)
    try:
        done = subprocess.run(
            words,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "OPENBLAS_NUM_THREADS": "1"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"reading it takes more than {seconds:.3g} seconds"
    said = done.stderr.decode("utf-8", "replace").strip()
    # The last line that the reader wrote names the error.
    return "" if done.returncode == 0 else said.splitlines()[-1] if said else f"a reader ended with {done.returncode}"
