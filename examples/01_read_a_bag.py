"""Read a recording without a running graph: python examples/01_read_a_bag.py BAG"""

import sys

import numpy as np

from np_record.bag import Recording

with Recording(sys.argv[1], required=["joint_states"]) as bag:
    seconds = (bag.end - bag.start) / 1e9
    print(f"{bag.path}: {seconds:.1f} s, {bag.information.get('domain', 'task unknown')}")
    for topic, count in sorted(bag.counts.items()):
        if count:
            print(f"  {topic:24} {count:7} messages, {count / seconds:6.1f} Hz")
    efforts = np.array([message.decode().effort[:7] for message in bag.messages("joint_states")])  # (n, 7) Nm
    print("largest torque without gravity, Nm:", np.abs(efforts).max(axis=0).round(2))
    for message in bag.messages("episode/phase"):
        print("phase:", message.decode().status[0].message)
