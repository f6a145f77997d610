"""pyzmq: as many DEALER sockets as workers, some chunks under way on each, and a ROUTER that copies and acknowledges.

    python -m research.benchmarks.intake.peer_zmq sink | player ADDRESS --folder RECORDED

The sink does what a hand-written learner would: arrays from the frames without a copy, one copy into the ring.
"""

import argparse
from pathlib import Path

import numpy as np
import zmq

from research.benchmarks.intake.chunks import NAMES, Ring, Window, read, steps_in_rows, write_result


def sink(address: str, folder: Path, seconds: float) -> None:
    """Take in until the window is over."""
    like = read(folder)
    shapes = {name: array.shape for name, array in like.items()}
    ring = Ring(like)
    context = zmq.Context()
    socket = context.socket(zmq.ROUTER)
    socket.bind(address)
    window = Window(lambda: (ring.rows, ring.bytes), seconds)
    while not window.over():
        if not socket.poll(20):
            continue
        sender, *frames = socket.recv_multipart(copy=False)
        parts = {
            name: np.frombuffer(frame.buffer, np.float32).reshape(shapes[name])
            for name, frame in zip(NAMES, frames, strict=True)
        }
        ring.add(parts)
        socket.send_multipart([sender.bytes, b"ok"])
    write_result(window.report(steps_in_rows(folder)))
    context.destroy(linger=0)


def player(address: str, folder: Path, workers: int, chunks: int) -> None:
    """Play until killed, with so many chunks of each worker under way."""
    chunk = read(folder)
    frames = [chunk[name] for name in NAMES]
    context = zmq.Context()
    poller = zmq.Poller()
    for _ in range(workers):
        socket = context.socket(zmq.DEALER)
        socket.connect(address)
        for _ in range(chunks):
            socket.send_multipart(frames, copy=False)
        poller.register(socket, zmq.POLLIN)
    while True:
        for socket, _ in poller.poll():
            socket.recv_multipart()
            socket.send_multipart(frames, copy=False)


def main() -> None:
    """Be one of the two."""
    parser = argparse.ArgumentParser()
    parser.add_argument("role", choices=("sink", "player"))
    parser.add_argument("address")
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--workers", type=int, default=8)
    parser.add_argument("--chunks", type=int, default=1, help="under way at once from each worker")
    options = parser.parse_args()
    if options.role == "sink":
        sink(options.address, options.folder, options.seconds)
    else:
        player(options.address, options.folder, options.workers, options.chunks)


if __name__ == "__main__":
    main()
