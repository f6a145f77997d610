"""What makes the simulator fast beyond plain compiled Python, one module each.

`decorators`: how functions are compiled, and the key of the machine code on disk. `argument_pack`: arguments unpacked
once, not at every call. `prefetch`: memory of the next environment, requested early. `logarithm`: a logarithm that the
compiler can vectorise.
"""
