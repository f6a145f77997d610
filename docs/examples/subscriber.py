import sys

import msgpack
import zenoh

config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", f'["{sys.argv[1]}"]')  # tcp/127.0.0.1:7447, for instance
with zenoh.open(config) as session:
    for sample in session.declare_subscriber("eia-sec/v1/*/metric/**"):
        frame = sample.payload.to_bytes()
        header = msgpack.unpackb(frame[24 : 24 + int.from_bytes(frame[8:12], "little")])
        print(sample.key_expr, header["fields"], flush=True)
