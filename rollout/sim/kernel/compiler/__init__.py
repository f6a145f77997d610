"""How the kernel is compiled: decorators, packed arguments, prefetching and a vectorisable logarithm."""
