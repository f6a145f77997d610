"""On which cores a process may run, and the environment that sets its compute threads."""

import os


def allowed_cores() -> int:
    """Return on how many cores this process, and every one that it starts, may run."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def thread_environment(threads: int) -> dict[str, str]:
    """Return the environment variables for a number of compute threads; set them before numpy is imported.

    OpenBLAS always gets one: the learner's kernels divide networks among numba's threads, each with its own products.
    """
    share = str(threads)
    names = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    return {**dict.fromkeys(names, share), "OPENBLAS_NUM_THREADS": "1"}
