"""The number of compute threads of a process, set for every library through the environment."""


def thread_environment(threads: int) -> dict[str, str]:
    """Return the environment variables for a number of compute threads; set them before numpy is imported.

    OpenBLAS always gets one: the learner's kernels divide networks among numba's threads, each with its own products.
    """
    share = str(threads)
    names = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    return {**dict.fromkeys(names, share), "OPENBLAS_NUM_THREADS": "1"}
