"""docs/reference/security.md: its text, and the access table that it shows, from `common.protocol.access`."""

from typing import Final

from common.protocol import access, keys
from common.protocol.frame import MAX_FRAME
from common.transport.admission import MOST_WAITING
from common.transport.credentials import ROLES
from common.transport.zenoh_config import ACCEPT_MS, HANDSHAKE_MS
from learner.intake.peer_penalties import CUT_SECONDS, LIMIT
from learner.intake.throttle import HOLD_SECONDS, MOST_BYTES, MOST_HELD

_TEXT: Final = """# Security

Generated from `common/protocol/access.py` and `docs/tools/security_page.py` by `make docs`; do not edit.

By default everything stays on the machine: processes listen on loopback alone, and neither multicast nor gossip
finds others. Listening on an address that other machines reach is refused, unless there is a certificate (`--tls`)
or somebody says that strangers are welcome (`--insecure`).

## Three hosts

A learner on `farm-1`, a worker on `farm-2`, a coordinator on `farm-3`. On a machine that does not train:

```sh
eia-sec keys init                                   # keys/ca.pem and keys/ca.key, ten years; keep ca.key here
eia-sec keys issue rollout worker-7                 # one folder for each process, one year (--days)
eia-sec keys issue elite coordinator
eia-sec keys issue monitor alice
eia-sec keys issue learner learner --host farm-1    # --host: every name or address under which it is reached
eia-sec keys show                                   # who, until when, let in or not
```

Copy each folder to its host, the learner's last or again: its `members.txt` names everybody who is let in (`scp -p`, so
that keys stay readable by their owner alone; a key that others can read is refused). Then:

```sh
eia-sec learner --listen tls/0.0.0.0:7447 --tls learner.learner --run-dir runs/farm       # on farm-1
eia-sec rollout --connect tls/farm-1:7447 --tls rollout.worker-7                          # on farm-2
eia-sec elite   --connect tls/farm-1:7447 --tls elite.coordinator                         # on farm-3
eia-sec monitor --connect tls/farm-1:7447 --tls monitor.alice                             # anywhere
```

Both ports, 7447 and 7448, must be reachable. `eia-sec train --tls keys` does the same on one machine; it needs
`learner.learner`, `elite.coordinator`, `operator.train` and `rollout.0`, `rollout.1`, ... With a file
that describes the hosts, `eia-sec fleet keys` and `eia-sec up` do all of this, with a router:
[hosts.md](../how-to/hosts.md).

**Renewal.** `eia-sec keys renew ROLE NAME` makes a new key and certificate for the same name and hosts; copy the
folder and start that process again. A link ends when its certificate does. `eia-sec keys show` marks what ends
within 30 days.
**A new process**, or one that must not come back (`eia-sec keys revoke ROLE NAME`): copy `members.txt` to the
listener and start that again with `--resume`; Zenoh reads access lists only at the start, and workers wait
meanwhile. There are no revocation lists: a struck process still gets a link until its certificate ends, and can do
nothing on it but see whether a learner lives. Issue names ahead where workers come and go. **A lost ca.key**: make
a new authority and issue everything anew. Certificates are for all runs of one authority; runs that must not see
each other need one authority each.

## Who may do what

Every link is TLS with certificates on both sides. The common name says role and name, `rollout.worker-7`. A
certificate serves only if it was issued with `--host`, so that a worker cannot pass for a learner. The listener
denies everything by default, and wildcards pass only where the whole of them is granted. `own` means the name in
the certificate.

{table}

*ask* sends a request and gets the answer; *answer* takes requests; *put* publishes; *read* subscribes; *appear* is
a liveliness token; *watch* sees tokens. Nobody may delete. The router only listens. `tests/security/test_matrix.py`
tries every role, key and kind of message, and wildcards, from real processes, and compares what is observed with
this table; with the access list switched off that test fails.

## What is checked on arrival

Frames are checked for length, checksum, kind and version, then types, shapes, ranges and finiteness, before memory
is taken for what they claim to hold ({limit_frame} MiB at most). The name in the envelope must be that in the key,
which must be that in the certificate. Samples and requests whose key holds a wildcard are dropped and counted.
Every name that is read from a file or a message (a run, a process, a type of agent in a policy, a worker in a history)
is 1 to 63 letters, digits, '.', '_' or '-', or what holds it is refused. `eia-sec export`, `fleet collect`, `fleet
render` and `up` write inside their folder only and follow no symbolic link there; texts of files and of other hosts
are printed without control characters.
Nothing is ever unpickled; a test forbids it in the source, and another watches whole processes with an audit hook.

A chunk must fit the run's configuration: it holds `rollout.chunk_steps` steps of each environment, and its step counts
follow from its number. An episode in it is as long as its environment flew since the last end; on the farm, as long as
every episode of that farm. It counts for the run only when its worker has delivered that many steps. A worker cannot
skip chunks that it has not delivered, and a parameter version that was never published counts as the newest. Whoever
claims otherwise is refused and named; the ledgers of the others stay exact.

A worker that sends {limit} requests in a row that bring nothing (unreadable, not usable, the same chunk again, out of
turn) is cut off for {seconds} s: it is refused without being looked at, named in the log once and in the learner's
alarms, and afterwards has one try. Each refusal is held back for {hold} s, so that whoever keeps some requests under
way waits for the answers instead of asking again at once. At most {held} requests or {held_bytes} MiB of them are
held; beyond that the oldest is refused at once. All are counted (`turned_away`).

A worker, coordinator, monitor or watcher that is denied says so: Zenoh drops a denied message in silence, but everybody
with a certificate may see whether a learner lives, so that no answer from a living learner is recognised. Vehicles and
flight nodes do not ask for one, and a denied one hears nothing. When certificates do not fit, the connecting side says
which and why, and exits with code 2.

## Strangers at the door

Whoever reaches the ports can open connections and leave them half open. Members that are in stay served; what suffers
is the admission of new ones:

- Silent connections to a listener with TLS may take {handshake_seconds} s for their handshake. With 400 of them held,
  a new member gets in at once.
- Silent connections to a listener without TLS are closed after {accept_seconds} s. With 900 held, a new member gets in
  at once; with 1,500, not until they are gone.
- For each TLS handshake that fails or is broken off Zenoh takes 0.1 s, one after another, and admits nobody meanwhile.
  300 connections that hang up keep new members out for 32 s, and ten a second for as long as they come.

The last is [an open issue of Zenoh](https://github.com/eclipse-zenoh/zenoh/issues/2685) that no setting changes. The
learner and the router raise an alarm when {most_waiting} such connections wait, or when half of their descriptors are
in use (`waiting_connections`, `descriptors`). Only a firewall prevents it: let only the members' networks reach the
ports, or limit new connections by address, for instance with nftables (a member opens two links):

```
tcp dport {{ 7447, 7448 }} ct state new meter members {{ ip saddr limit rate over 4/second burst 40 packets }} drop
```

## Protected, from whom

| what | from whom |
|---|---|
| transitions, parameters, metrics on the wire | anybody without a certificate: not read, not changed, not injected |
| parameters | everybody but the learner |
| a worker's transitions, metrics and evaluations | other workers, monitors |
| imitation events, orders to evaluate | everybody but the coordinator |
| stopping the run | everybody but an operator |
| a vehicle's observations | other vehicles, and everybody else but the flight node that reads them |
| set-points | everybody but a flight node; each is read by its own vehicle alone ([how](../how-to/vehicles.md)) |
| the learner's process and memory | malformed, oversized, non-finite input of a worker |

## Not protected

- From the holder of `ca.key`, of the learner's key, or of a host that a process runs on: keys lie there
  unencrypted.
- From a worker that lies well: valid, finite transitions that are made up are learnt from (poisoning). Its share is
  in the ledger by name; whether it is true is not checked.
- Against floods of connections by strangers: see [above](#strangers-at-the-door). A member who does not wait for
  answers can fill its link.
- From a worker that ends episodes early, where their length is not fixed: each step that it delivers may end an
  episode, and the run ends after `episodes` of them. On the farm the length is fixed.
- From a worker that delivers too much: whole and new chunks are taken in the order in which they come, so who sends
  more than the others has a larger share of what is learnt from. The ledger tells it by name.
- Traffic analysis: sizes and times of messages are visible.
- With `--shared-memory`, `--tls` or not: chunks then pass through `/dev/shm` in the clear. Its segments are readable by
  the user alone that the processes run as; other users of the machine do not see them, root does.
- On loopback without `--tls`: other users of the same machine can join. Use `--tls` there, too, if there are such.
- `--env module:name` runs that module's code. A worker loads only what its own command line names, never what the
  learner's configuration asks for.
- Files in the run directory: whoever may write there decides what is resumed. They are checked, not signed. The
  same holds for numba's cache of compiled code in `__pycache__`, which numba itself reads with pickle;
  `NUMBA_CACHE_DIR` puts it elsewhere.
"""

_WORDS: Final = ("put", "answer", "ask", "read", "appear", "watch")


def security_page() -> str:
    """Return docs/reference/security.md."""
    return _TEXT.format(
        table=access_table(),
        limit=LIMIT,
        seconds=f"{CUT_SECONDS:.0f}",
        limit_frame=MAX_FRAME // 2**20,
        handshake_seconds=HANDSHAKE_MS // 1000,
        accept_seconds=ACCEPT_MS // 1000,
        most_waiting=MOST_WAITING + 1,
        hold=f"{HOLD_SECONDS:.0f}",
        held=MOST_HELD,
        held_bytes=MOST_BYTES // 2**20,
    )


def access_table() -> str:
    """Return the access table: one row for each shape of key, one column for each role."""
    shown = [role for role in ROLES if role != "router"]
    rows: dict[str, dict[str, list[str]]] = {}
    for grant in access.GRANTS:
        for role in shown if grant.role == access.ANYBODY else [grant.role]:
            given = {key: "own" if value == access.NAME else value for key, value in grant.variables.items()}
            scope = ", ".join(given[name] for name in given if f"{{{name}}}" in grant.family.template)
            word = f"{grant.right} ({scope})" if scope else grant.right
            found = rows.setdefault(grant.family.template, {}).setdefault(role, [])
            if grant.right not in found:  # what everybody may adds nothing to the same right on all keys
                found.append(word)
    lines = [f"| key | {' | '.join(shown)} |", "|---" * (len(shown) + 1) + "|"]
    for family in keys.FAMILIES:
        cells = [", ".join(sorted(rows[family.template].get(role, ["-"]), key=_order)) for role in shown]
        lines.append(f"| `{family.template}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def _order(word: str) -> int:
    return _WORDS.index(word.split(" ", maxsplit=1)[0]) if word != "-" else 0
