"""The one tree of typed errors.

EiaSecError
├── UsageError                 a user's mistake: one clear sentence, exit code 2
│   ├── ConfigError            an unknown key, an impossible value
│   ├── EndpointError          an endpoint that is in use, dead or malformed
│   │   └── CredentialsError   a certificate or key that is missing, readable by others, expired or of another process
│   ├── RunDirError            a run directory that is missing, in use or of another configuration
│   ├── PolicyError            a policy name or file that cannot be used
│   ├── ContractError          an environment that does something else than PettingZoo asks for
│   ├── EnvironmentFaultError  an exception in a user's environment, with its traceback
│   ├── PluginError            a plug-in that cannot be used, or an exception in one
│   └── CallbackError          something that is no callback, or an exception in one
├── ProtocolError              received data that violates the protocol
│   ├── FrameError             bytes that are not a frame: truncated, corrupted, oversized
│   ├── SchemaError            a frame whose fields have the wrong type, shape or range
│   ├── VersionError           another protocol version or another team layout
│   └── KeyExpressionError     a key that no declaration covers
├── SimulationError            a simulated farm used against its contract
├── EnvironmentOutageError     a simulator or robot that is away for a while, as its environment says
├── CancelledError             work that was given up because its process ends
├── GroupError                 a group of learners that has lost a member, or whose members differ
├── HostError                  a host of a fleet that cannot be reached, or on which a command failed
├── CheckpointError            a checkpoint that is truncated, corrupted or of another layout
└── BusError                   the bus cannot do what was asked
    ├── BusClosedError         the session is closed
    └── ForkedProcessError     a session used in a process that did not open it
"""


class EiaSecError(Exception):
    """Root of every error that this project raises on purpose."""


class UsageError(EiaSecError):
    """A user's mistake. The message is one sentence; commands print it and exit with code 2."""


class ConfigError(UsageError):
    """A configuration with an unknown key or an impossible value."""


class EndpointError(UsageError):
    """An endpoint that is malformed, already in use, or where nobody answers."""


class CredentialsError(EndpointError):
    """A certificate or key that cannot be used: missing, readable by others, expired, or of another process."""


class RunDirError(UsageError):
    """A run directory that is missing, in use, or belongs to another configuration."""


class PolicyError(UsageError):
    """A policy name that does not exist or a policy file that cannot be used."""


class DivergenceError(UsageError):
    """Training has made networks that are not finite; to begin it again with the same settings would do the same."""


class ContractError(UsageError):
    """An environment that does something else than PettingZoo asks for."""


class EnvironmentFaultError(UsageError):
    """An exception in a user's environment; the message holds the traceback of the user's own code."""


class PluginError(UsageError):
    """A plug-in that cannot be used, or an exception in its code; the message names plug-in, class and method."""


class CallbackError(UsageError):
    """Something that is no callback, or an exception in a user's callback."""


class ProtocolError(EiaSecError):
    """Received data that violates the protocol."""


class FrameError(ProtocolError):
    """Bytes that are not a frame: truncated, corrupted, oversized or of another kind."""


class SchemaError(ProtocolError):
    """A whole frame with a field of the wrong type, shape or range, or with a number that is not finite."""


class VersionError(ProtocolError):
    """A frame of another protocol version, or for another team layout."""


class KeyExpressionError(ProtocolError):
    """A key that no declaration of the protocol covers."""


class SimulationError(EiaSecError):
    """A simulated farm used against its contract: stepped beyond its end, or with impossible actions."""


class EnvironmentOutageError(EiaSecError):
    """An environment's simulator or robot is away for a while.

    Environments raise it in `reset` or `step`. A worker ends the episode and tries again until it is back.
    """


class CancelledError(EiaSecError):
    """Work that was given up because its process ends."""


class GroupError(EiaSecError):
    """A group of learners that has lost a member, or whose members hold different parameters; all of it ends."""


class HostError(EiaSecError):
    """A host of a fleet that cannot be reached, or on which a command failed."""


class CheckpointError(EiaSecError):
    """A checkpoint that is truncated, corrupted, or of another layout."""


class BusError(EiaSecError):
    """The bus cannot do what was asked."""


class BusClosedError(BusError):
    """The session is closed."""


class ForkedProcessError(BusError):
    """A session used in a process other than the one that opened it."""


class TerminatedError(SystemExit):
    """SIGTERM in a process that does not handle it: it unwinds, so that everything is closed."""
