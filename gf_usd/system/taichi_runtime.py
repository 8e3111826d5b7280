"""The only module that imports and starts Taichi."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import io
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import cache, wraps
from types import ModuleType
from typing import Any

from gf_usd.core.errors import GfUsdError, UsageError
from gf_usd.system.fast_start.imports import quick_import
from gf_usd.system.fast_start.kernels import install_replacements, remove_replacements
from gf_usd.system.resources import cores

DEVICES = ("cpu", "cuda")
MULTIPROCESSOR_COUNT = 16  # CU_DEVICE_ATTRIBUTE_MULTIPROCESSOR_COUNT of the CUDA driver's interface
THREADS = 8  # least number of threads that kernels are compiled for
# [bytes] Taichi's default of 100 MB holds 175 kernels: with a few laws, masses and precisions
# in turn, kernels are evicted and compiled again.
KERNEL_CACHE = 1 << 30
# Taichi's configuration with and without its elimination of common subexpressions:
# see `without_common_subexpressions`.  Its hoisting of loop invariants relies on that pass: a
# reduction over a loop into an array element is wrong without it (docs/upstream.md).
MERGE_OPTIONS = {
    True: {"opt_level": 1, "cache_loop_invariant_global_vars": True},
    False: {"opt_level": 0, "cache_loop_invariant_global_vars": False},
}
CACHE_FOLDER = "TI_OFFLINE_CACHE_FILE_PATH"  # environment variable with the folder of kernels

FORKED = "this process was forked from one that had started Taichi, which does not run in it"
SPAWN = (
    "use the spawn method: multiprocessing.get_context('spawn'), as in"
    " ProcessPoolExecutor(mp_context=...)"
)

# Environment variables while Taichi is imported and started.
QUIET = {
    "ENABLE_TAICHI_HEADER_PRINT": "0",
    "TI_SKIP_VERSION_CHECK": "ON",  # a weekly request to the network
    "TI_ENABLE_PYBUF": "0",  # a message on stderr where stdout is wrapped
}

_started: dict[str, Any] = {}
_starts = 0
_runtime: Any = None  # that of the last start here
_process = 0  # that of the last start here
_guests = 0  # nested `as_guest`
_watchers: list[Callable[[bool], None]] = []  # of `watching`


def import_taichi() -> ModuleType:
    """The taichi module, imported without its banner.

    Raises GfUsdError where a system library that Taichi links to is missing.
    """
    taichi = _imported()
    install_replacements(taichi)
    return taichi


@contextlib.contextmanager
def as_guest() -> Iterator[None]:
    """Use Taichi within the block, and remove all replacements in it afterwards."""
    global _guests  # noqa: PLW0603  (blocks of a process nest)
    if "taichi" in sys.modules:
        import_taichi()
    _guests += 1
    try:
        yield
    finally:
        _guests -= 1
        if not _guests:
            remove_replacements()


@contextlib.contextmanager
def watching(watcher: Callable[[bool], None]) -> Iterator[None]:
    """Call watcher(True) before kernels are compiled or loaded, and watcher(False) after it."""
    _watchers.append(watcher)
    try:
        yield
    finally:
        _watchers.remove(watcher)


@contextlib.contextmanager
def compiling() -> Iterator[None]:
    """Compile kernels, or load compiled ones, within the block: see `watching`."""
    for watcher in _watchers:
        watcher(True)
    try:
        yield
    finally:
        for watcher in _watchers:
            watcher(False)


def is_started_by_host() -> bool:
    """Whether other code of this process has started Taichi, which has one runtime per process."""
    if "taichi" not in sys.modules:
        return False
    now = importlib.import_module("taichi.lang.impl").get_runtime()
    return now is not _runtime and now.prog is not None


def is_forked() -> bool:
    """Whether Taichi was started before this process was forked; its threads do not exist here."""
    return _starts > 0 and os.getpid() != _process


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    with _environment({name: text for name, text in QUIET.items() if name not in os.environ}):
        yield


@contextlib.contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables within the block."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, text in before.items():
            if text is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = text


def is_running() -> bool:
    """Whether Taichi runs as it was started here, without a reset or another start since."""
    if _runtime is None or is_forked():
        return False
    now = importlib.import_module("taichi.lang.impl").get_runtime()
    return now is _runtime and now.prog is not None


def _set_home() -> None:
    """Set HOME where it is not set, as in systemd units: Taichi would abort the process.

    It stays set, because Taichi reads it at each reset, including at the end of the process.
    """
    if os.name != "posix" or {"HOME", "XDG_CACHE_HOME"} & os.environ.keys():
        return
    import pwd

    try:
        home = pwd.getpwuid(os.getuid()).pw_dir
    except KeyError:  # a user id without a name, as in containers
        home = os.devnull  # cannot contain a folder; the temporary one is open to others
    os.environ["HOME"] = home


@cache
def _kernel_cache() -> tuple[bool, str]:
    """Whether the folder of compiled kernels exists, and a note where it cannot be written.

    Called before Taichi is started, which crashes at its end where it cannot create the folder.
    """
    default = importlib.import_module("taichi").lang.impl.default_cfg().offline_cache_file_path
    folder = os.environ.get(CACHE_FOLDER) or default
    hint = f"set {CACHE_FOLDER} to a folder that can be written"
    try:
        os.makedirs(folder, exist_ok=True)
    except OSError as error:
        return False, (
            f"the folder of compiled kernels {folder} cannot be made ({error.strerror}), so that "
            f"kernels are compiled in every run; {hint}"
        )
    if not os.access(folder, os.W_OK):
        return True, (
            f"the folder of compiled kernels {folder} cannot be written, so that kernels it lacks "
            f"are compiled in every run; {hint}"
        )
    return True, ""


def kernel_cache_notes() -> tuple[str, ...]:
    """Notes on the folder of compiled kernels, once Taichi was started."""
    note = _kernel_cache()[1] if _starts else ""
    return (note,) if note else ()


@cache
def _imported() -> ModuleType:
    _set_home()
    try:
        with _quiet(), quick_import(), warnings.catch_warnings():
            # Taichi uses deprecated functions, which would fail with -W error
            warnings.simplefilter("ignore", DeprecationWarning)
            return importlib.import_module("taichi")
    except ImportError as error:
        if "libX11" in str(error):
            raise GfUsdError(
                f"Taichi cannot be loaded: {error}",
                "install the system library, on Debian and Ubuntu: apt-get install libx11-6",
            ) from error
        raise GfUsdError(
            f"Taichi cannot be loaded: {error}",
            "install it: python -m pip install 'taichi>=1.7.4,<1.8'",
        ) from error


def init_taichi(device: str = "cpu", threads: int | None = None, f64: bool = False) -> None:
    """Start Taichi, unless it already runs with the same arguments.

    Other arguments restart it, which invalidates all existing fields and ndarrays.  On the CPU
    ``real_matrix_scalarize`` is off, as the solver's SIMD kernels require; a kernel must then build
    vectors by hand and never load one from a ``Vector.field``.  On CUDA it is on, because Taichi
    has no square root of a vector there.  ``fast_math`` is off so that results do not depend on the
    vectorization of a loop.  In 64 bits and on CUDA, all kernels are compiled as by
    `without_common_subexpressions`: those in 64 bits are of tests and verification, where compiling
    dominates, and those on CUDA use scalars for vectors.  In 32 bits on the CPU, a substep of the
    Total Lagrangian solver would take 1 to 2 % longer.

    Parameters
    ----------
    device : "cpu" or "cuda".
    threads : CPU threads; None: all that this process may use.
    f64 : floating-point literals and unnamed types are 64 bits wide.

    Raises
    ------
    UsageError : unknown device, fewer than one thread, or CUDA where there is none.
    GfUsdError : a system library is missing, or this process was forked from one that uses Taichi.
    """
    if is_forked():
        raise GfUsdError(FORKED, SPAWN)
    if device not in DEVICES:
        raise UsageError(f"unknown device {device!r}", f"choose one of: {', '.join(DEVICES)}")
    if threads is not None and threads < 1:
        raise UsageError(f"{threads} CPU threads were requested", "give 1 or more")
    wanted = {"device": device, "threads": threads or cores(), "f64": f64}
    if _started == wanted and is_running():
        return
    ti = import_taichi()
    if device == "cuda" and not _has_cuda(ti):
        raise UsageError(
            "no CUDA device was found",
            "use --device cpu, or check with nvidia-smi that the driver sees the card",
        )
    global _starts, _runtime, _process  # noqa: PLW0603  (the state of Taichi is the process's, not ours)
    _started.clear()
    if _starts:
        _keep_arrays_allocated()
    kept = _kernel_cache()[0]
    # without the cache nothing is written there, but the folder must exist
    elsewhere = {} if kept else {CACHE_FOLDER: os.path.abspath(os.sep)}
    # ti.init prints the architecture on stdout, which is for the data of --json
    with _quiet(), _environment(elsewhere), contextlib.redirect_stdout(io.StringIO()):
        ti.init(
            arch=ti.cuda if device == "cuda" else ti.cpu,
            default_fp=ti.f64 if f64 else ti.f32,
            cpu_max_num_threads=wanted["threads"],
            offline_cache=kept,
            offline_cache_max_size_of_files=KERNEL_CACHE,
            real_matrix_scalarize=device == "cuda",
            fast_math=False,
            unrolling_limit=0,  # the 27 x 3 lane vectors of a group are unrolled on purpose
            log_level=ti.ERROR,
            **MERGE_OPTIONS[not f64 and device == "cpu"],
        )
    _fix_compiled_thread_count(ti, wanted["threads"])
    _started.update(wanted)
    _starts += 1
    _process = os.getpid()
    _runtime = ti.lang.impl.get_runtime()


def without_common_subexpressions(kernel: Callable[..., None]) -> Callable[..., None]:
    """The kernel, compiled without Taichi's elimination of common subexpressions.

    For each match, Taichi traverses the whole kernel: three quarters of the compile time of the
    Updated Lagrangian solver's kernels, and more where vectors become scalars.  LLVM finds most of
    the matches too.  Results are identical to the bit.
    """

    @wraps(kernel)  # including the attributes that Taichi sets
    def launch(*values: Any) -> None:
        config = importlib.import_module("taichi").lang.impl.get_runtime().prog.config()
        before = {name: getattr(config, name) for name in MERGE_OPTIONS[False]}
        try:
            for name, value in MERGE_OPTIONS[False].items():
                setattr(config, name, value)
            kernel(*values)
        finally:
            for name, value in before.items():
                setattr(config, name, value)

    return launch


def _keep_arrays_allocated() -> None:
    """Prevent arrays that were made before a restart from being freed after it.

    Taichi frees by address.  The restart has freed all memory, and new arrays may have the same
    addresses.
    """
    gc.collect()
    kinds = (
        importlib.import_module("taichi.lang._ndarray").Ndarray,
        importlib.import_module("taichi.lang.argpack").ArgPack,
    )
    for one in gc.get_objects():
        if issubclass(type(one), kinds):
            object.__setattr__(one, "__class__", _without_destructor(type(one)))


@cache
def _without_destructor(kind: type) -> type:
    return type(kind.__name__, (kind,), {"__del__": lambda self: None})


def _fix_compiled_thread_count(ti: ModuleType, threads: int) -> None:
    """Compile for THREADS threads, so that a kernel's key does not depend on the thread count.

    The thread pool is already created and limits the threads of a loop.  Only the number of pieces
    of a loop is compiled in: more pieces than threads do no harm.
    """
    config = ti.lang.impl.get_runtime().prog.config()
    config.cpu_max_num_threads = max(THREADS, threads)


def epoch() -> int:
    """Number of starts of Taichi; objects of an earlier epoch must be rebuilt."""
    return _starts


def ensure_taichi() -> None:
    """Start Taichi on the CPU unless it already runs in 32 bits, on any device.

    For drawing between the frames of a solver, which should not restart Taichi.  Kernels with
    32-bit vectors do not compile where literals are 64 bits wide, so a runtime with ``f64`` is
    restarted.
    """
    if not is_running() or _started["f64"]:
        init_taichi(_started.get("device", "cpu"), _started.get("threads"))


def ensure_running() -> None:
    """Start Taichi unless it runs, with any arguments."""
    if not is_running():
        init_taichi()


def resident_blocks() -> int:
    """Thread blocks that the GPU runs concurrently, two per multiprocessor; 0 on a CPU.

    Taichi compiles each kernel so that two of its blocks fit (`minctasm` in its code generator).
    """
    return 2 * _multiprocessors() if _started.get("device") == "cuda" else 0


@cache
def cuda_driver() -> ctypes.CDLL:
    """The CUDA driver that Taichi uses."""
    return ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")


@cache
def _multiprocessors() -> int:
    """Number of multiprocessors of the driver's first device, which Taichi uses."""
    driver = cuda_driver()
    device, count = ctypes.c_int(), ctypes.c_int()
    failed = (
        driver.cuInit(0)
        or driver.cuDeviceGet(ctypes.byref(device), 0)
        or driver.cuDeviceGetAttribute(ctypes.byref(count), MULTIPROCESSOR_COUNT, device)
    )
    if failed:
        raise GfUsdError(
            f"the CUDA driver did not say how many multiprocessors the GPU has: error {failed}",
            "use --device cpu, or check with nvidia-smi that the driver sees the card",
        )
    return count.value


def threads() -> int:
    """Number of threads that Taichi was started with; `cores` where it does not run."""
    return _started.get("threads") or cores()


def _has_cuda(ti: ModuleType) -> bool:
    ti.set_logging_level(ti.ERROR)  # no warning where there is no driver
    return bool(ti.lang.misc.is_arch_supported(ti.cuda))
