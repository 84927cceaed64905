"""The cache directory, files that are either complete or absent, and netCDF-4 files."""

from __future__ import annotations

import hashlib
import os
import secrets
import tempfile
import warnings
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import platformdirs

from .validation import InputError, file_path

if TYPE_CHECKING:
    import xarray as xr


@cache
def directory() -> Path:
    """STIFFBEAM_CACHE_DIR, else the platform's cache directory, else a temporary one with a warning."""
    wanted = os.environ.get("STIFFBEAM_CACHE_DIR") or platformdirs.user_cache_dir("stiffbeam")
    path = Path(wanted)
    try:
        # For this user alone, whatever the umask: JAX keeps compiled code here.
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        # Only writing shows that a folder can be written to.
        with tempfile.TemporaryFile(dir=path):
            return path
    except OSError:
        path = Path(tempfile.mkdtemp(prefix="stiffbeam-"))
        warnings.warn(
            f"cannot write to the cache directory {wanted}: using {path} for this process; "
            "set STIFFBEAM_CACHE_DIR to a writable directory of your own to keep references and what JAX compiles",
            stacklevel=2,
        )
        return path


@cache
def source_hash(folder: Path = Path(__file__).parents[1]) -> str:
    """Hash of the code and data in a folder, by default the package's. It changes with every edit, so old results are
    not reused."""
    digest = hashlib.sha256()
    for file in sorted({x for kind in ("*.py", "*.toml", "*.[ch]") for x in folder.rglob(kind)}):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def regular_text(field: str, file: Path, most: int) -> str:
    """The text of a regular file of at most ``most`` bytes, UTF-8 or else Latin-1. Raises InputError for any other, as
    devices and pipes, which have no end."""
    try:
        if not file.is_file():
            raise OSError("it does not exist, or is a folder, a device or a pipe")
        with file.open("rb") as stream:
            content = stream.read(most + 1)
    except OSError as error:
        raise InputError(field, str(file), "be a readable file", f"give another: {error}") from None
    if len(content) > most:
        raise InputError(field, str(file), f"have at most {most} bytes", "put a part of it into another file")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def write_whole(file: str | Path, content: str | bytes) -> Path:
    """Write ``content`` to the file, text in UTF-8. The old content stays until the new one is completely on the disk.

    Folders on the way are made, and the file has the mode that the umask gives. Raises InputError for a place that
    cannot be written to, and where there is no room.
    """
    path = file_path("file", file)
    data = content.encode("utf-8") if isinstance(content, str) else content
    partial = path.parent / f".{secrets.token_hex(8)}.partial"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
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


def content_hash(data: xr.Dataset) -> str:
    """sha256 of every variable and attribute but for the hash itself and what differs from machine to machine."""
    digest = hashlib.sha256()
    for name in sorted(map(str, data.variables)):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(data[name].values).tobytes())
    for name in sorted(map(str, data.attrs.keys() - {"hash", "deviation"})):
        digest.update(f"{name}={data.attrs[name]}".encode())
    return digest.hexdigest()


def make_folder(folder: str | Path, option: str = "--out") -> Path:
    """``folder``, created if necessary; InputError if that is impossible or nothing can be written there."""
    folder = file_path(option, folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        remedy = f"{error.strerror or error}: name another"
        raise InputError(option, str(folder), "be a folder that can be written to", remedy) from None
    return folder


def write_netcdf(data: xr.Dataset, file: str | Path, compression: int = 0) -> Path:
    """Write a netCDF-4 file, compressed where ``compression`` is 1 to 9: into memory first, since HDF5 does not survive
    a full disk. Raises InputError for a place that cannot be written to."""
    packing = {"zlib": True, "complevel": compression, "shuffle": True} if compression else {}
    encoding: dict[Any, Any] = {
        name: {"_FillValue": None} | (packing if variable.size and variable.dims else {})
        for name, variable in data.variables.items()
    }
    return write_whole(file, bytes(data.to_netcdf(engine="h5netcdf", encoding=encoding)))


def read_netcdf(file: Path) -> xr.Dataset:
    """The arrays in a netCDF-4 file of one group. Raises InputError for a file that cannot be read."""
    import h5py
    import xarray as xr

    try:
        with h5py.File(file) as whole:  # what h5netcdf asks first; where that fails its own file is not closed
            whole.attrs.get("_nc3_strict")
        with xr.open_dataset(file, engine="h5netcdf", decode_cf=False, cache=False) as data:
            return data.load()
    except Exception as error:  # whatever HDF5 raises for a damaged file, or one that another tool has written
        remedy = f"make it again, of a run by save('run.nc'): {error}"
        raise InputError("file", str(file), "be a whole netCDF-4 file", remedy) from None
