"""Check of an installation: what it has and what it lacks."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

from hiltestbed.compiled.warm import cores
from hiltestbed.process.output import has_display

EXTRAS = {  # optional package, to its purpose and the extra that installs it
    "h5py": ("HDF5 data", "hdf5"),
    "asammdf": ("MDF4 data", "mdf"),
    "nptdms": ("TDMS data", "tdms"),
    "mcap": ("MCAP data", "mcap"),
    "mcap_ros2": ("ROS 2 bags", "mcap"),
    "distributed": ("campaigns on a cluster", "cluster"),
    "pandas": ("to_pandas()", "pandas"),
    "xarray": ("to_xarray()", "xarray"),
    "fmpy": ("FMUs", "fmi"),
}
NEEDED = (
    "mujoco",
    "pin",
    "numpy",
    "scipy",
    "numba",
    "rerun-sdk",
    "pyarrow",
    "matplotlib",
    "pydantic",
)


@dataclass(frozen=True)
class Examined:
    """One check: its subject, its result, whether that is good, and whether hiltestbed needs it."""

    what: str
    state: str
    good: bool
    needed: bool = True


def examine() -> list[Examined]:
    """Versions, optional packages, cores, compiled kernels, viewer and plugins."""
    found = [Examined("python", sys.version.split()[0], sys.version_info >= (3, 11))]
    for name in ("hiltestbed", *NEEDED):
        try:
            found.append(Examined(name, version(name), True))
        except PackageNotFoundError:
            what = "is not installed; pip install hiltestbed installs it"
            found.append(Examined(name, what, False))
    for name, (purpose, extra) in EXTRAS.items():
        here = find_spec(name) is not None
        lacks = f"not installed ({purpose}); pip install 'hiltestbed[{extra}]'"
        found.append(Examined(name, purpose if here else lacks, here, needed=False))
    found.append(Examined("cores", str(cores()), True))
    found += [_cache(), _viewer(), _plugins()]
    return found


def _cache() -> Examined:
    from hiltestbed.compiled.warm import cache_folder, compiled

    folder = cache_folder()
    above = next(path for path in (folder, *folder.parents) if path.exists())
    if not os.access(above, os.W_OK):
        return Examined(
            "compiled kernels",
            f"{folder} cannot be written: every run compiles again; set NUMBA_CACHE_DIR",
            False,
        )
    return Examined(
        "compiled kernels",
        f"in {folder}"
        if compiled()
        else "none yet: the first run compiles them, in about a minute",
        True,
    )


def _viewer() -> Examined:
    display = has_display()
    state = (
        "a display is available"
        if display
        else "no display: `hiltestbed view` needs one; report.html only needs a browser"
    )
    return Examined("viewer", state, display, needed=False)


def _plugins() -> Examined:
    from hiltestbed import plugins
    from hiltestbed.errors import InputError

    try:
        plugins.load()
    except InputError as error:
        return Examined("plugins", str(error), False)
    return Examined("plugins", ", ".join(plugins.loaded()) or "none", True)
