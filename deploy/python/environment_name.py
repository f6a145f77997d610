"""The name of an environment that a program gives as a class or a function."""

from eia_sec.common.errors import ConfigError


def environment_name(environment: object, *, elsewhere: bool) -> str:
    """Return the name under which processes can make an environment.

    Args:
        environment: its name already, or a class or function of a module.
        elsewhere: whether other processes must import it, which they cannot from a script or a notebook.

    Raises:
        ConfigError: it has no name by which it can be imported.
    """
    if isinstance(environment, str):
        return environment
    module, member = getattr(environment, "__module__", ""), getattr(environment, "__qualname__", "")
    if not callable(environment) or not module or not member:
        raise ConfigError(f"an environment is module:name or a class or function, not {environment!r}.")
    if "<" in member:
        raise ConfigError(f"{member} is defined inside a function or is a lambda; define it at the top of a module.")
    if module == "__main__" and elsewhere:
        raise ConfigError(
            f"{member} is defined in a script or a notebook, which workers cannot import; move it into a module, or "
            "train with workers=0."
        )
    return f"{module}:{member}"
