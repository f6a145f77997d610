import sys

import msgpack
import zenoh

where = f'{{mode: "client", connect: {{endpoints: ["{sys.argv[1]}"]}}}}'  # tcp/127.0.0.1:7447, for instance
with zenoh.open(zenoh.Config.from_json5(where)) as session:
    subscriber = session.declare_subscriber("eia-sec/v5/*/metric/*/*")  # without a name it would be gone at once
    for sample in subscriber:
        frame = sample.payload.to_bytes()
        header = msgpack.unpackb(frame[24 : 24 + int.from_bytes(frame[8:12], "little")])
        print(sample.key_expr, header["fields"], flush=True)
