"""Reads any run with the protocol's schema alone; needs eclipse-zenoh, msgpack and numpy, and nothing of this project.

    python reader.py ENDPOINT RUN protocol.json

prints the run's newest progress and the sizes of its newest actors, which a plain GET answers, then what is published.
"""

import json
import sys

import msgpack
import numpy as np
import zenoh


def decode(payload, schema):
    """Return the name of the message in a frame, and its fields; raise ValueError when it does not fit the schema."""
    header_size, body_size = int.from_bytes(payload[8:12], "little"), int.from_bytes(payload[12:20], "little")
    whole = len(payload) >= 24 and len(payload) == 24 + header_size + body_size
    names = [name for name, message in schema["messages"].items() if whole and message["kind"] == payload[5]]
    if not names or payload[:4] != b"EIAS" or payload[4] != schema["protocol"]:
        raise ValueError("this is no whole frame of the schema's protocol")
    name, message = names[0], schema["messages"][names[0]]
    header = msgpack.unpackb(payload[24 : 24 + header_size])
    fields, offset = header["fields"], 24 + header_size
    for path, dtype, shape in header["arrays"]:
        count = int(np.prod(shape))
        array = np.frombuffer(payload, dtype, count, offset).reshape(shape)
        offset += array.nbytes
        part, dot, _ = path.partition(".")
        if dot:  # one of a list of arrays
            fields.setdefault(part, []).append(array)
        else:
            fields[path] = array
    known = {field["name"]: field["optional"] for field in message["fields"]}
    if odd := fields.keys() - known or {n for n, optional in known.items() if not optional} - fields.keys():
        raise ValueError(f"{name} has other fields than the schema says: {sorted(odd)}")
    return name, fields


def main(endpoint, run, path):
    """Print the newest state, then everything that comes."""
    with open(path, encoding="utf-8") as file:
        schema = json.load(file)
    here = f"{schema['root']}/{run}"
    where = f'{{mode: "client", connect: {{endpoints: ["{endpoint}"]}}}}'
    with zenoh.open(zenoh.Config.from_json5(where)) as session:
        for key in ("ctl/progress", "params/actors"):
            for reply in session.get(f"{here}/{key}/@adv/**?_anyke", timeout=5.0):
                if reply.ok is not None:
                    name, fields = decode(reply.ok.payload.to_bytes(), schema)
                    if name == "ParametersMessage":
                        fields["flat"] = [list(array.shape) for array in fields["flat"]]
                    print(name, fields, flush=True)
        subscriber = session.declare_subscriber(f"{here}/**")
        for sample in subscriber:
            try:
                name, fields = decode(sample.payload.to_bytes(), schema)
            except ValueError as error:
                print(sample.key_expr, error, flush=True)
            else:
                print(sample.key_expr, sample.encoding, name, sorted(fields), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
