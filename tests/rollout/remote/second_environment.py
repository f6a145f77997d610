"""A second implementation of docs/reference/remote_protocol.md, written from that page: zenoh and msgpack, no eia_sec.

`python second_environment.py NAME LOCATOR` serves a counter of two agents, as a program in C++ or Rust would.
"""

import json
import struct
import sys
import time

import msgpack
import zenoh

ROOT = "eia-sec/environment/v1"
AGENTS = ["north", "south"]
SEEN = {"type": "box", "dtype": "<f4", "shape": [2], "low": -100.0, "high": 100.0}
ACTS = {"type": "discrete", "n": 2, "start": 0}
LEASE_SECONDS = 5.0


def is_action(value):
    return type(value) is int and 0 <= value - ACTS["start"] < ACTS["n"]


class Counter:
    """Counts each agent's ones, for ten steps."""

    living = ()

    def begin(self, seed):
        self.time, self.counts, self.living = 0, dict.fromkeys(AGENTS, 0), AGENTS
        return {"observations": self.seen(), "infos": {}, "agents": AGENTS}

    def step(self, actions):
        self.time += 1
        for name, action in actions.items():
            self.counts[name] += action
        over = self.time == 10
        self.living = () if over else AGENTS
        return {
            "observations": self.seen(),
            "rewards": {name: float(actions[name]) for name in AGENTS},
            "terminations": dict.fromkeys(AGENTS, over),
            "truncations": dict.fromkeys(AGENTS, False),
            "infos": {},
            "agents": [] if over else AGENTS,
        }

    def seen(self):
        return {name: struct.pack("<2f", self.counts[name], self.time) for name in AGENTS}


class Environment:
    """Leases, numbers and answers, as the page's section on them says."""

    def __init__(self):
        self.counter, self.incarnation = Counter(), time.time_ns() // 1000
        self.lease, self.nonce, self.held, self.until = 0, None, False, 0.0
        self.newest, self.answer = 0, None

    def handle(self, verb, payload):
        try:
            answer = getattr(self, verb)(msgpack.unpackb(payload))
        except (KeyError, TypeError, ValueError, AttributeError, msgpack.UnpackException):
            answer = {"status": "malformed", "reason": "it cannot be read."}
        return msgpack.packb(answer)

    def claim(self, request):
        now = time.monotonic()
        again = request["nonce"] == self.nonce and self.newest == 0
        if not (again and self.held):
            if self.held and now < self.until:
                return {"status": "taken", "reason": "somebody else has it."}
            if request["nonce"] == self.nonce:
                return {"status": "lost", "reason": "this claim is over."}
            self.lease, self.nonce, self.held = self.lease + 1, request["nonce"], True
            self.newest, self.answer = 0, None
        self.until = now + LEASE_SECONDS
        return {
            "status": "done",
            "incarnation": self.incarnation,
            "lease": self.lease,
            "lease_seconds": LEASE_SECONDS,
            "copies": 1,
            "agents": AGENTS,
            "observation_spaces": [SEEN] * 2,
            "action_spaces": [ACTS] * 2,
        }

    def step(self, request):
        number = request["sequence"]
        if not self.holds(request):
            return {"status": "lost", "sequence": number, "reason": "it is not yours."}
        if number == self.newest and self.answer is not None:
            return self.answer
        if number != self.newest + 1:
            return {"status": "late" if number <= self.newest else "gap", "sequence": number}
        (order,) = request["copies"]
        if isinstance(order, int) and order >= 0:
            moved = self.counter.begin(order)
        elif order.keys() == set(self.counter.living) and all(is_action(action) for action in order.values()):
            moved = self.counter.step(order)
        else:
            raise ValueError(order)
        self.newest, self.until = number, time.monotonic() + LEASE_SECONDS
        self.answer = {"status": "done", "sequence": number, "copies": [moved]}
        return self.answer

    def renew(self, request):
        if not self.holds(request):
            return {"status": "lost"}
        self.until = time.monotonic() + LEASE_SECONDS
        return {"status": "done"}

    def release(self, request):
        answer = self.renew(request)
        self.held = self.held and answer["status"] != "done"
        return answer

    def holds(self, request):
        return self.held and (request["incarnation"], request["lease"]) == (self.incarnation, self.lease)


def main(name, locator):
    config = zenoh.Config()
    values = {"mode": "client", "connect/endpoints": [locator], "scouting/multicast/enabled": False}
    for key, value in values.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        environment = Environment()
        requests = session.declare_queryable(f"{ROOT}/request/{name}/*", zenoh.handlers.RingChannel(64), complete=True)
        token = session.liveliness().declare_token(f"{ROOT}/live/{name}")
        while token:
            query = requests.handler.recv()
            with query:
                verb = str(query.key_expr).rpartition("/")[2]
                query.reply(query.key_expr, environment.handle(verb, query.payload.to_bytes()))


if __name__ == "__main__":
    main(*sys.argv[1:])
