"""The JointTrajectory of ``machopt optimize … --post ros_json`` as a ROS 2 bag, without ROS.

    pip install '.[ros]'
    python ros_bag.py out/part/part_cls.json bag --topic /joint_trajectory

The bag (sqlite, one message) is a folder that ``ros2 bag play`` and ``ros2 bag info`` take.
"""

import argparse
import json
import sys
from pathlib import Path

TYPE = "trajectory_msgs/msg/JointTrajectory"


def message(document, types, array):
    """The JSON document as rosbags' message.

    Args:
        document: what ``--post ros_json`` wrote.
        types: class of each message by its name.
        array: makes an array of numbers.
    """
    stamp = types["builtin_interfaces/msg/Time"](**document["header"]["stamp"])
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=document["header"]["frame_id"])
    points = [
        types["trajectory_msgs/msg/JointTrajectoryPoint"](
            **{key: array(point[key]) for key in ("positions", "velocities", "accelerations", "effort")},
            time_from_start=types["builtin_interfaces/msg/Duration"](**point["time_from_start"]),
        )
        for point in document["points"]
    ]
    return types[TYPE](header=header, joint_names=list(document["joint_names"]), points=points)


def write(file, bag, topic):
    """Write the bag; returns the number of points."""
    try:
        import numpy
        from rosbags.rosbag2 import Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise SystemExit("a bag needs rosbags: pip install '.[ros]'") from None
    store = get_typestore(Stores.ROS2_HUMBLE)
    told = message(json.loads(Path(file).read_text(encoding="utf-8")), store.types, numpy.array)
    with Writer(bag, version=8) as writer:
        way = writer.add_connection(topic, TYPE, typestore=store)
        writer.write(way, 0, store.serialize_cdr(told, TYPE))
    return len(told.points)


def main(words):
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("program", type=Path, help="what --post ros_json wrote")
    parser.add_argument("bag", type=Path, help="folder to write, which must not exist")
    parser.add_argument("--topic", default="/joint_trajectory")
    asked = parser.parse_args(words)
    print(f"{asked.bag}: one {TYPE} of {write(asked.program, asked.bag, asked.topic)} points on {asked.topic}")


if __name__ == "__main__":
    main(sys.argv[1:])
