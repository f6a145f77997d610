"""How many compute threads a process starts: its share, given to every library by its environment."""


def thread_environment(threads: int) -> dict[str, str]:
    """Return the variables that give a process so many compute threads; they count before numpy is loaded.

    OpenBLAS always has one: the learner's kernels share networks among numba's threads, each with products of its own.
    """
    share = str(threads)
    names = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    return {**dict.fromkeys(names, share), "OPENBLAS_NUM_THREADS": "1"}
