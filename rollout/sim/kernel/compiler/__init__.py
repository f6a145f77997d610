"""Techniques that make the simulator faster than plain compiled Python, one module each.

`decorators` compiles functions and keys the machine code on disk. `argument_pack` unpacks arguments once instead of at
every call. `prefetch` requests the next environment's memory early. `logarithm` is a logarithm that the compiler can
vectorise.
"""
