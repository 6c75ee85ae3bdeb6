"""One recording as others would have written it: storage, compression, files, order, clocks, joints, QoS, byte order, padding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from np_description.panda import JOINT_NAMES
from np_record.bag import Message
from np_record.cdr import TYPESTORE, meaningful_bytes

FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
WALL = 1_760_000_000_000_000_000  # ns
JITTER = 400_000  # ns


@dataclass(frozen=True)
class Variant:
    """How a recording is written."""

    storage: str
    """mcap or sqlite3."""
    compression: str
    """none, file, message, or storage (of chunks within an .mcap file)."""
    files: int
    """How many it is split into, listed in any order."""
    clock: str
    """header: logged at the stamps; late: 20 ms later; jitter: up to .4 ms later; images: these .45 s later; wall: arrival by another clock."""
    joints: str
    """same; shuffled: in another order, with one more; gripper: arm and gripper in turn, the latter with positions only; nan: no effort of the
    fingers."""
    qos: str
    """same, or mixed: another in each file."""
    big_endian: bool
    """Whether messages are big-endian."""
    padding: bool
    """Whether padding is random, and bytes follow the messages."""
    twice: bool
    """Whether some joint states are recorded twice."""
    frames: bool
    """Whether the frame of joint states changes."""

    @staticmethod
    def draw(seed: int) -> Variant:
        """The variant of this number."""
        rng = np.random.default_rng(seed)
        storage = str(rng.choice(["mcap", "sqlite3"]))
        compressions = ["none", "file", "message", *(["storage"] if storage == "mcap" else [])]
        return Variant(
            storage,
            str(rng.choice(compressions)),
            int(rng.integers(1, 4)),
            str(rng.choice(["header", "header", "late", "jitter", "images", "wall"])),
            str(rng.choice(["same", "shuffled", "gripper", "nan"])),
            str(rng.choice(["same", "mixed"])),
            *(bool(value) for value in rng.random(4) < (0.3, 0.5, 0.3, 0.3)),
        )

    @property
    def refusals(self) -> tuple[str, ...]:
        """Words of which each error must have one, where the recording cannot be read as the original."""
        words = ("have no stamp, and joint_states is logged",) if self.clock == "wall" else ()
        fingers = {"gripper": ("panda_finger_joint",), "nan": ("JointState.effort of panda_finger",)}
        return (*words, *fingers.get(self.joints, ()))


def write_variant(path: Path, messages: Sequence[Message], variant: Variant, seed: int, run_info: str = "{}") -> Path:
    """Write the messages (by time) as a bag."""
    rng = np.random.default_rng(seed)
    arriving = []
    for message in messages:
        for data in _datas(message, variant, rng):
            arriving.append((_logged(message, variant, rng), message.topic, data))
            if variant.twice and message.topic.name == "joint_states" and rng.random() < 0.05:
                arriving.append((arriving[-1][0], message.topic, data))
    arriving.sort(key=lambda item: item[0])
    path.mkdir()
    bounds = np.linspace(0, len(arriving), variant.files + 1).astype(int)
    parts = [
        _write_part(path / f"part_{number}", arriving[begin:end], variant, number, run_info)
        for number, (begin, end) in enumerate(zip(bounds, bounds[1:]))
    ]
    _merge(path, [parts[i] for i in rng.permutation(len(parts))])
    return path


def _logged(message: Message, variant: Variant, rng: np.random.Generator) -> int:
    if variant.clock == "late":
        return message.stamp + 20_000_000
    if variant.clock == "jitter":
        return message.stamp + int(rng.integers(0, JITTER))
    if variant.clock == "images" and message.topic.name.startswith("camera/"):
        return message.stamp + 450_000_000
    if variant.clock == "wall":  # at half of real time
        return WALL + 2 * message.stamp + int(rng.integers(0, JITTER))
    return message.stamp


def _datas(message: Message, variant: Variant, rng: np.random.Generator) -> list[bytes]:
    decoded = message.decode()
    parts = [decoded]
    if message.topic.name == "joint_states":
        if variant.frames:
            decoded.header.frame_id = "base" * int(rng.integers(0, 2))
        parts = _states(decoded, variant)
    return [_serialize(part, variant, rng) for part in parts]


def _states(message, variant: Variant) -> list:
    kind, arrays = type(message), ("position", "velocity", "effort")
    if variant.joints == "shuffled":
        order = [3, 8, 0, 6, 1, 2, 7, 5, 4]
        values = {name: np.r_[9.0, getattr(message, name)[order]] for name in arrays}
        return [kind(message.header, ["rail", *(message.name[i] for i in order)], **values)]
    if variant.joints == "gripper":
        arm = {name: getattr(message, name)[:7] for name in arrays}
        hand = {"position": message.position[7:], "velocity": np.zeros(0), "effort": np.zeros(0)}
        return [kind(message.header, [*JOINT_NAMES], **arm), kind(message.header, [*FINGERS], **hand)]
    if variant.joints == "nan":
        message.effort = np.r_[message.effort[:7], np.nan, np.nan]
    return [message]


def _serialize(message, variant: Variant, rng: np.random.Generator) -> bytes:
    kind = message.__msgtype__
    if variant.big_endian:
        return bytes(TYPESTORE.serialize_cdr(message, kind, little_endian=False))
    data = np.frombuffer(bytes(TYPESTORE.serialize_cdr(message, kind)), np.uint8).copy()
    if variant.padding:
        free = np.flatnonzero(~meaningful_bytes(kind, data.tobytes()))
        free = free[data[free] == 0]
        data[free] = rng.integers(0, 256, len(free))
        data = np.r_[data, rng.integers(0, 256, int(rng.integers(0, 9))).astype(np.uint8)]
    return data.tobytes()


def _write_part(path: Path, arriving: Sequence, variant: Variant, number: int, run_info: str) -> Path:
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[variant.storage.upper()])
    writer.set_compression(CompressionMode[variant.compression.upper()], CompressionFormat.ZSTD)
    writer.set_custom_data("run_info", run_info)
    is_other = variant.qos == "mixed" and number > 0
    with writer:
        connections = {}
        for logged, topic, data in arriving:
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    f"/{topic.name}", topic.type, typestore=TYPESTORE, offered_qos_profiles=[_qos(number)] * is_other
                )
            writer.write(connections[topic], logged, data)
    return path


def _merge(path: Path, parts: Sequence[Path]) -> None:
    """One bag of several: their files, and the metadata of all."""
    whole, counts = None, {}
    begins, ends = [], []
    for part in parts:
        content = yaml.safe_load((part / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
        (part / "metadata.yaml").unlink()
        for file in part.iterdir():
            file.rename(path / file.name)
        part.rmdir()
        begins.append(content["starting_time"]["nanoseconds_since_epoch"])
        ends.append(begins[-1] + content["duration"]["nanoseconds"])
        for topic in content["topics_with_message_count"]:
            known = counts.setdefault(topic["topic_metadata"]["name"], {**topic, "message_count": 0})
            known["message_count"] += topic["message_count"]
        if whole is None:
            whole = content
        else:
            whole["relative_file_paths"] += content["relative_file_paths"]
            whole["files"] += content["files"]
            whole["message_count"] += content["message_count"]
    whole["topics_with_message_count"] = list(counts.values())
    whole["starting_time"]["nanoseconds_since_epoch"] = min(begins)
    whole["duration"]["nanoseconds"] = max(ends) - min(begins)
    (path / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": whole}))


def _qos(depth: int) -> Qos:
    forever = QosTime(2147483647, 4294967295)
    return Qos(
        QosHistory.KEEP_LAST,
        depth,
        QosReliability.BEST_EFFORT,
        QosDurability.VOLATILE,
        forever,
        forever,
        QosLiveliness.AUTOMATIC,
        forever,
        False,
    )
