"""Logs as other programs write them: of a car with a radar on one topic and an odometer on another one."""

import csv
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

Floats = NDArray[Any]
EPOCH = 1_700_000_000_000_000_000
"""Nanoseconds at the begin of a log of messages."""
RADAR, ODOMETER = "/radar", "/odom"
VECTOR = "float64 x\nfloat64 y\nfloat64 z\n"
TWIST = f"geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n{'=' * 80}\nMSG: geometry_msgs/Vector3\n{VECTOR}"
OF_MESSAGES = {"distance": "/radar.range", "speed": "/odom.linear.x"}
"""Where the columns are, in every form of messages."""


def write_csv(path: Path, columns: Mapping[str, Iterable[object]], delimiter: str = ",") -> Path:
    with path.open("w", newline="") as file:
        writer = csv.writer(file, delimiter=delimiter)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return path


def write_parquet(path: Path, columns: Mapping[str, Floats]) -> Path:
    import pyarrow as pa
    from pyarrow import parquet

    parquet.write_table(pa.table({name: pa.array(each) for name, each in columns.items()}), path)
    return path


def write_mat(path: Path, columns: Mapping[str, Floats]) -> Path:
    from scipy.io import savemat

    savemat(path, {"log": dict(columns), "version": "R2026a"})
    return path


def stamps(times: Floats) -> list[int]:
    return [EPOCH + round(float(t) * 1e9) for t in times]


def write_json_mcap(path: Path, times: Floats, distance: Floats, speed: Floats) -> Path:
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        radar, odometer = (writer.register_channel(topic, "json", schema) for topic in (RADAR, ODOMETER))
        for stamp, d, v in zip(stamps(times), distance, speed, strict=True):
            for channel, message in ((radar, {"range": d}), (odometer, {"linear": {"x": v}, "name": "car"})):
                writer.add_message(channel, stamp, json.dumps(message).encode(), stamp)
        writer.finish()
    return path


def write_protobuf_mcap(path: Path, times: Floats, distance: Floats, speed: Floats) -> Path:
    """Write messages of types that only the file describes."""
    from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass
    from mcap.writer import Writer

    def described(name: str, fields: Mapping[str, str | None]) -> tuple[bytes, Any]:
        proto = FileDescriptorProto(name=f"{name}.proto", package="car", syntax="proto3")
        inner = proto.message_type.add(name="Vector")
        inner.field.add(name="x", number=1, type=1, label=1)
        outer = proto.message_type.add(name=name)
        for number, (field, kind) in enumerate(fields.items(), start=1):
            if kind is None:
                outer.field.add(name=field, number=number, type=1, label=1)
            else:
                outer.field.add(name=field, number=number, type=11, label=1, type_name=f".car.{kind}")
        pool = DescriptorPool()
        pool.Add(proto)
        kind_of: Any = GetMessageClass(pool.FindMessageTypeByName(f"car.{name}"))
        return FileDescriptorSet(file=[proto]).SerializeToString(), kind_of

    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        kinds: dict[str, tuple[str, Mapping[str, str | None]]]
        kinds = {RADAR: ("Radar", {"range": None}), ODOMETER: ("Odom", {"linear": "Vector"})}
        channels = {}
        for topic, (name, fields) in kinds.items():
            data, kind = described(name, fields)
            schema = writer.register_schema(f"car.{name}", "protobuf", data)
            channels[topic] = writer.register_channel(topic, "protobuf", schema), kind
        for stamp, d, v in zip(stamps(times), distance, speed, strict=True):
            for topic, values in ((RADAR, {"range": d}), (ODOMETER, {"linear": {"x": v}})):
                channel, kind = channels[topic]
                writer.add_message(channel, stamp, kind(**values).SerializeToString(), stamp)
        writer.finish()
    return path


def ros_messages(store: Any, distance: float, speed: float, stamp: int) -> dict[str, tuple[str, Any]]:
    """Return a message for each topic, of types that every ROS has."""
    kinds = store.types
    header = kinds["std_msgs/msg/Header"](
        **{"seq": 0} if "seq" in kinds["std_msgs/msg/Header"].__dataclass_fields__ else {},
        stamp=kinds["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9),
        frame_id="radar",
    )
    vector = kinds["geometry_msgs/msg/Vector3"]
    return {
        RADAR: (
            "sensor_msgs/msg/Range",
            kinds["sensor_msgs/msg/Range"](
                header=header,
                radiation_type=0,
                field_of_view=0.1,
                min_range=0.0,
                max_range=200.0,
                range=distance,
                **{"variance": 0.0} if "variance" in kinds["sensor_msgs/msg/Range"].__dataclass_fields__ else {},
            ),
        ),
        ODOMETER: (
            "geometry_msgs/msg/Twist",
            kinds["geometry_msgs/msg/Twist"](linear=vector(speed, 0.0, 0.0), angular=vector(0.0, 0.0, 0.0)),
        ),
    }


def write_bag(path: Path, times: Floats, distance: Floats, speed: Floats, *, form: str) -> Path:
    """Write a bag of ROS 1 (`ros1`), or of ROS 2 in `sqlite3` or `mcap`."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if form == "ros1" else Stores.ROS2_HUMBLE)
    plugins = {"sqlite3": rosbag2.StoragePlugin.SQLITE3, "mcap": rosbag2.StoragePlugin.MCAP}
    bag: Any = rosbag1.Writer(path) if form == "ros1" else rosbag2.Writer(path, version=9, storage_plugin=plugins[form])
    with bag as writer:
        connections: dict[str, Any] = {}
        for stamp, d, v in zip(stamps(times), distance, speed, strict=True):
            for topic, (kind, message) in ros_messages(store, d, v, stamp).items():
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=store)
                serialize = store.serialize_ros1 if form == "ros1" else store.serialize_cdr
                writer.write(connections[topic], stamp, serialize(message, kind))
    return path


def write_ros_mcap(path: Path, times: Floats, distance: Floats, speed: Floats, *, form: str) -> Path:
    """Write messages of ROS 1 or ROS 2 into an MCAP file of its own."""
    from mcap.writer import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if form == "ros1" else Stores.ROS2_HUMBLE)
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start("ros1" if form == "ros1" else "ros2")
        channels: dict[str, int] = {}
        for stamp, d, v in zip(stamps(times), distance, speed, strict=True):
            for topic, (kind, message) in ros_messages(store, d, v, stamp).items():
                if topic not in channels:
                    text, _ = store.generate_msgdef(kind, ros_version=1 if form == "ros1" else 2)
                    short = kind.replace("/msg/", "/") if form == "ros1" else kind
                    schema = writer.register_schema(short, f"{form}msg", text.encode())
                    encoding = "ros1" if form == "ros1" else "cdr"
                    channels[topic] = writer.register_channel(topic, encoding, schema)
                serialize = store.serialize_ros1 if form == "ros1" else store.serialize_cdr
                writer.add_message(channels[topic], stamp, bytes(serialize(message, kind)), stamp)
        writer.finish()
    return path
