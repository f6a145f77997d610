"""Serve a simulator or a robot as the environment of a run.

    from eia_sec.remote import serve
    serve(MyParallelEnv(), name="site-a", connect="tcp/learner:7447")

This module needs zenoh, msgpack and numpy, and with a certificate cryptography. It loads neither torch nor the farm.
"""

from eia_sec.rollout.remote.serving import serve

__all__ = ["serve"]
