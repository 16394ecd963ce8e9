#!/usr/bin/env python3
"""Sends crafted and mutated RTPS packets to `palpate live --localhost`, and reports what they do.

    sudo scripts/rtps_attack.py target/release/palpate data/plant_a [--packets 200000] [--seed 0]

First single packets that have broken DDS implementations (a HEARTBEAT or GAP over all numbers, a
DATA_FRAG of gigabytes), then packets of the session itself, mutated. For each: memory of palpate and its
network process, how often that was replaced, and after how long joint states are heard again. Needs
root, to read what passes the loopback interface, numpy and cyclonedds.
"""

import argparse
import json
import os
import random
import socket
import struct
import sys
import tempfile
import threading
import time
from pathlib import Path

import dds_robot as dds
from guard_situations import Scene
from soak import memory_mib

HEARTBEAT, GAP, DATA, DATA_FRAG = 0x07, 0x08, 0x15, 0x16
EXTREMES = [0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 1 << 20, 1 << 28]


def submessages(packet):
    """Of each: kind, where it begins, and its length."""
    at = 20
    while at + 4 <= len(packet):
        kind, length = packet[at], struct.unpack_from("<H", packet, at + 2)[0]
        length = length or len(packet) - at - 4
        yield kind, at, length
        at += 4 + length


class Capture(threading.Thread):
    """All RTPS packets on the loopback interface: (port, packet)."""

    def __init__(self):
        super().__init__(daemon=True)
        self.socket = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.ntohs(3))
        self.socket.bind(("lo", 0))
        self.packets, self.going = [], True

    def run(self):
        while self.going:
            frame = self.socket.recv(65535)
            if frame[12:14] == b"\x08\0" and frame[23] == 17:
                udp = frame[14 + (frame[14] & 15) * 4 :]
                if udp[8:12] == b"RTPS":
                    self.packets.append((struct.unpack_from(">H", udp, 2)[0], udp[8:]))


def ports(pid):
    """UDP addresses of a process."""
    inodes = {os.readlink(fd) for fd in Path(f"/proc/{pid}/fd").iterdir() if fd.exists() or fd.is_symlink()}
    found = []
    for line in Path(f"/proc/{pid}/net/udp").read_text().splitlines()[1:]:
        fields = line.split()
        if f"socket:[{fields[9]}]" in inodes:
            address, port = fields[1].split(":")
            found.append((socket.inet_ntoa(bytes.fromhex(address)[::-1]), int(port, 16)))
    return found


class Target:
    """A session, its robot that plays all the time, and packets that were seen."""

    def __init__(self, args, domain, folder):
        capture = Capture()
        capture.start()
        self.scene = Scene(args, domain, folder, more=["--memory-mib", "8"])  # of frames to replay
        self.scene.args = args
        self.going = True
        self.player = threading.Thread(target=self.play, daemon=True)
        self.player.start()
        time.sleep(2)
        capture.going = False
        self.network = self.scene.network_process()
        own = {port for _, port in ports(self.network)}
        self.packets = list({packet: (port, packet) for port, packet in capture.packets if port in own}.values())
        self.base_mib = self.peak_mib = self.memory()
        self.out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def play(self):
        while self.going:
            self.scene.robot.play(range(100))

    def memory(self):
        """Of palpate and of its network process, MiB."""
        try:
            return memory_mib(self.scene.palpate.pid), memory_mib(self.scene.network_process())
        except StopIteration:
            return 0.0, 0.0  # it is being replaced

    def watch(self):
        self.peak_mib = [max(pair) for pair in zip(self.peak_mib, self.memory())]

    def send(self, packet, port):
        try:
            self.out.sendto(packet[:65000], ("127.0.0.1", port))
        except OSError:
            pass

    def lines(self):
        lines = self.scene.log.read_text(errors="replace").splitlines()
        return [json.loads(line) for line in lines if line.startswith("{") and line.endswith("}")]

    def received(self):
        return next((line["received"] for line in reversed(self.lines()) if "received" in line), 0)

    def joint_state(self):
        """The last packet with a joint state, and where its DATA begins."""
        for port, packet in reversed(self.packets):
            for kind, at, _ in submessages(packet):
                if kind == DATA and b"Actuator1" in packet:
                    return port, packet, at
        sys.exit("no joint state was seen on the loopback interface")

    def crafted(self, kind):
        """A packet that claims to come from the robot's writer."""
        port, packet, at = self.joint_state()
        reader, writer = packet[at + 8 : at + 12], packet[at + 12 : at + 16]
        number = struct.unpack_from("<iI", packet, at + 16)[1]
        if kind == HEARTBEAT:
            body = reader + writer + struct.pack("<iIiIi", 0, 1, 0, 0x7FFFFFFF, 1 << 20)
        elif kind == GAP:
            body = reader + writer + struct.pack("<iIiII", 0, number + 1, 0, 0x7FFFFFFF, 0)
        else:
            body = struct.pack("<HH", 0, 28) + reader + writer + struct.pack("<iI", 0, number + 1)
            body += struct.pack("<IHHI", 1, 1, 64, 0xFFFFFFF0) + b"\0\1\0\0" + bytes(60)
        return port, packet[:20] + bytes([kind, 1]) + struct.pack("<H", len(body)) + body

    def hears_again_s(self):
        """How long it takes until joint states are heard; `None` if they are not within 30 s."""
        until = time.monotonic() + 2.5  # what a packet does is seen after some time
        while time.monotonic() < until:
            self.watch()
            time.sleep(0.01)
        started, before = time.monotonic(), self.received()
        while time.monotonic() < started + 30:
            self.watch()
            if self.received() > before + 50:
                return round(time.monotonic() - started, 1)
            time.sleep(0.1)
        return None

    def report(self, what):
        heard = self.hears_again_s()
        notes = [line["note"] for line in self.lines() if "note" in line]
        replaced = sum("started" in note or "anew" in note or "replaced" in note for note in notes)
        result = {
            "what": what, "memory_mib": [round(mib) for mib in self.base_mib],
            "peak_mib": [round(mib) for mib in self.peak_mib],
            "replaced": replaced, "hears_again_s": heard, "alive": self.scene.palpate.poll() is None,
            "defects": [note for note in notes if "defect" in note],
        }
        self.going = False
        self.player.join()
        if self.scene.args.log:
            self.scene.args.log.write_text(self.scene.log.read_text(errors="replace"))
        started = time.monotonic()
        self.scene.end()
        result["ends_after_s"] = round(time.monotonic() - started, 1)
        print(json.dumps(result), flush=True)
        grows_mib = sum(self.peak_mib) - sum(self.base_mib)
        return heard is not None and grows_mib < 100 and result["alive"]


def mutated(packet, rng):
    packet = bytearray(packet)
    for _ in range(rng.choice([1, 1, 2, 4, 10])):
        kind, at = rng.randrange(7), rng.randrange(16, len(packet)) if len(packet) > 17 else 0
        if kind == 0:
            packet[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            packet[at] = rng.choice([0, 1, 0x7F, 0x80, 0xFF])
        elif kind == 2:
            packet[at : at + 4] = struct.pack("<I", rng.choice(EXTREMES))[: len(packet) - at]
        elif kind == 3 and len(packet) > 40:
            del packet[at:]
        elif kind == 4:
            packet[at:at] = rng.randbytes(8)
        elif kind == 5 and len(packet) > 40:
            del packet[at : at + rng.choice([1, 4, 8])]
        else:
            packet[at : at + 8] = struct.pack("<d", rng.choice([float("nan"), 1e308, float("inf")]))
    return bytes(packet)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("palpate", type=Path)
    parser.add_argument("set", type=Path)
    parser.add_argument("--packets", type=int, default=200_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--domain", type=int, default=61)
    parser.add_argument("--log", type=Path, help="where to leave what palpate printed last")
    args = parser.parse_args()
    held = []
    for number, (name, kind, count) in enumerate(
        [("heartbeat", HEARTBEAT, 1), ("gap", GAP, 1), ("data_frag", DATA_FRAG, 1), ("200 data_frags", DATA_FRAG, 200)]
    ):
        with tempfile.TemporaryDirectory() as folder:
            target = Target(args, args.domain + number, Path(folder))
            if number == 0:
                print(json.dumps({"sockets": ports(target.network)}))
            port, packet = target.crafted(kind)
            for _ in range(count):
                target.send(packet, port)
                time.sleep(0.005)
            held.append(target.report(name))
    with tempfile.TemporaryDirectory() as folder:
        target = Target(args, args.domain + 10, Path(folder))
        rng = random.Random(args.seed)
        for sent in range(args.packets):
            port, packet = rng.choice(target.packets)
            target.send(mutated(packet, rng), port)
            if sent % 50 == 0:
                time.sleep(0.01)
                target.watch()
        held.append(target.report(f"{args.packets} mutated packets"))
    sys.exit(not all(held))


if __name__ == "__main__":
    main()
