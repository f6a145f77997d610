"""Exit codes and error messages of commands."""

import errno
import io
import signal
import subprocess
import sys

import pytest

from eia_sec.common.errors import BusError, CancelledError, CheckpointError, ConfigError, EndpointError, RunDirError
from eia_sec.deploy.exit_codes import run_command


def raising(error):
    def command():
        raise error

    return command


@pytest.mark.parametrize(("result", "code"), [(None, 0), (0, 0), (3, 3)])
def test_result_is_the_exit_code(result, code):
    """A command's own exit code is passed on, and nothing means success."""
    assert run_command(lambda: result) == code


@pytest.mark.parametrize("kind", [ConfigError, EndpointError, RunDirError])
def test_mistake_of_the_user_is_one_line_and_two(kind, capsys):
    """A user's mistake prints its sentence on standard error, nothing else, and exits with 2."""
    assert run_command(raising(kind("episodes must be above 0, not -1."))) == 2
    captured = capsys.readouterr()
    assert captured.err == "eia-sec: episodes must be above 0, not -1.\n"
    assert captured.out == ""


@pytest.mark.parametrize("number", [errno.EACCES, errno.ENAMETOOLONG, errno.ENOTDIR])
def test_a_path_that_cannot_be_used_is_a_mistake(number, capsys):
    """Where a user may not go, or no path can lead, is one sentence; without a path it is a defect."""
    assert run_command(raising(OSError(number, "no way", "runs/mine"))) == 2
    assert capsys.readouterr().err == "eia-sec: runs/mine cannot be used: no way.\n"
    with pytest.raises(OSError, match="no way"):
        run_command(raising(OSError(number, "no way")))


def test_an_error_message_commands_no_terminal(capsys):
    """What came from a file into a message is printed without control characters."""
    assert run_command(raising(ConfigError("the type 'a\x1b]0;owned\x07\u202e' is unknown."))) == 2
    assert capsys.readouterr().err == "eia-sec: the type 'a?]0;owned??' is unknown.\n"


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (CheckpointError("the checkpoint is cut."), "eia-sec: the checkpoint is cut.\n"),
        (BusError(), "eia-sec: BusError\n"),
    ],
)
def test_expected_failure_is_one_line_and_one(error, line, capsys):
    """Any other error of the project prints one line and exits with 1."""
    assert run_command(raising(error)) == 1
    assert capsys.readouterr().err == line


def test_interrupt_is_130(capsys):
    """Ctrl-C exits with 130 and without a traceback."""
    assert run_command(raising(KeyboardInterrupt())) == 130
    assert capsys.readouterr().err == "eia-sec: interrupted.\n"


def test_defect_keeps_its_traceback():
    """An exception that nobody expects passes through."""
    with pytest.raises(ZeroDivisionError):
        run_command(lambda: 1 // 0)


def test_closed_pipe_is_quiet():
    """A command whose reader goes away ends with 141 and writes nothing to standard error."""
    code = (
        "import sys; from eia_sec.deploy.exit_codes import run_command;"
        "sys.exit(run_command(lambda: [sys.stdout.write('line\\n' * 1000) for _ in range(1000)] and None))"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.readline()
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait() == 141


@pytest.mark.parametrize("stream", [None, "full"])
def test_a_sentence_that_nobody_gets_changes_no_code(stream, monkeypatch):
    """A user's mistake is 2 also where standard error is closed or its disk full, so that nobody restarts it."""

    class Full(io.StringIO):
        def write(self, text):
            raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr(sys, "stderr", Full() if stream else None)
    assert run_command(raising(ConfigError("no."))) == 2


def test_who_is_ended_while_it_waits_has_not_failed(capsys):
    """Nothing is said, and the code is 0."""
    assert run_command(raising(CancelledError("ended."))) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.slow
def test_sigterm_ends_a_command_that_does_not_handle_it():
    """With 128 + SIGTERM, after what the command had begun was ended."""
    script = (
        "import eia_sec.deploy.cli as c, time; c.dispatch = lambda words: (print(flush=True), time.sleep(60)); c.main()"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        process.terminate()
        assert process.wait(30.0) == 143


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_signal_while_options_are_parsed_is_no_mistake_of_the_user(number, code):
    """The exit code is that of the signal, so that a supervisor starts the command again."""
    script = (
        "import os, signal, sys, time, tyro, eia_sec.deploy.cli as c\n"
        f"tyro.cli = lambda *a, **k: (os.kill(os.getpid(), {int(number)}), time.sleep(60))\n"
        "sys.argv = ['eia-sec', 'status', 'none.toml']; c.main()"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, "invalid command line" in done.stderr) == (code, False)


@pytest.mark.slow
def test_ctrl_c_during_an_import_prints_one_line(tmp_path):
    """A command's module takes seconds to load; Ctrl-C meanwhile leaves no traceback of somebody's import."""
    (tmp_path / "slow.py").write_text("import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(60)\n")
    script = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import eia_sec.deploy.cli as c\n"
        "c.COMMANDS['slow'] = c.Command('slow', ''); sys.argv = ['eia-sec', 'slow']; c.main()"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "eia-sec: interrupted.\n")


@pytest.mark.slow
@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_a_closed_stream_changes_no_exit_code(closed, tmp_path):
    """With standard streams closed by the caller a command does its work; no file of its own takes their numbers."""
    (tmp_path / "fleet.toml").write_text('[learner]\nhost = "one"\n[hosts.one]\nhost = "local"\n')
    words = f"{sys.executable} -m eia_sec.deploy.cli fleet check {tmp_path / 'fleet.toml'} {closed}"
    done = subprocess.run(["sh", "-c", words], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
