"""Reads an export of a map with the official readers: RECORDING FACTS. Facts are what the map itself says, as JSON."""

import json
import sys
from collections import Counter, defaultdict
from pathlib import Path

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from mcap_ros2.decoder import DecoderFactory as RosDecoderFactory

ENCODINGS = {"foxglove": ("protobuf", "protobuf"), "nav_msgs": ("ros2msg", "cdr")}


def occupied(messages, cells):
    """Holds an occupancy grid to its cells: [column, row, side, least value, greatest value]; elsewhere nobody knows."""
    if not cells:
        assert not messages
        return
    (grid,) = messages
    info = grid.info
    assert grid.header.frame_id == "map" and len(grid.data) == info.width * info.height
    assert (info.origin.orientation.w, info.origin.orientation.z) == (1, 0)
    values = list(grid.data)
    for column, row, side, least, greatest in cells:
        assert abs(info.resolution - side) < 1e-6
        x = ((column + 0.5) * side - info.origin.position.x) / side
        y = ((row + 0.5) * side - info.origin.position.y) / side
        at = int(y) * info.width + int(x)
        assert 0 <= x < info.width and least <= values[at] <= greatest, (column, row, values[at], least, greatest)
        values[at] = -1
    assert all(value == -1 for value in values)


def main(path, facts):
    facts = json.loads(Path(facts).read_text())
    counts, transforms, seen = Counter(), {}, defaultdict(list)
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory(), RosDecoderFactory()])
        last = 0
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            package = schema.name.split(".")[0].split("/")[0]
            assert (schema.encoding, channel.message_encoding) == ENCODINGS[package], schema.name
            assert message.log_time >= last
            last = message.log_time
            counts[schema.name] += 1
            seen[channel.topic].append(decoded)
            if schema.name == "foxglove.FrameTransform" and decoded.parent_frame_id == "map":
                session = decoded.child_frame_id.split("/")[0]
                transforms[session, message.log_time] = decoded.translation
    for session, stamp, x, y in facts["poses"]:
        at = transforms.pop((session, stamp))
        assert abs(at.x - x) < 1e-9 and abs(at.y - y) < 1e-9
    assert not transforms
    sessions = {session for session, *_ in facts["poses"]}
    for session in sessions:
        (trajectory,) = seen[f"/trajectory/{session}"]
        assert len(trajectory.poses) == sum(1 for one, *_ in facts["poses"] if one == session)
    for topic, layer in {"/lanes": "lanes", "/spaces": "parking_spaces", "/labels": "placed_labels"}.items():
        entities = [entity for update in seen[topic] for entity in update.entities]
        assert len(entities) == facts["rows"].get(layer, 0), (topic, len(entities))
        assert all(entity.frame_id == "map" and entity.lines[0].points for entity in entities)
    landmarks = sum(len(cloud.data) // cloud.point_stride for cloud in seen["/landmarks"])
    assert landmarks == facts["rows"].get("landmarks", 0)
    assert counts["foxglove.CompressedImage"] == facts["images"]
    for topic, messages in seen.items():
        if topic.startswith("/camera/") and topic.count("/") == 3:
            assert all(one.data[:2] == b"\xff\xd8" or one.data[:4] == b"\x89PNG" for one in messages), topic
            assert topic + "/calibration" in seen, topic
    for grid in seen["/ground"]:
        assert len(grid.data) % (4 * grid.column_count) == 0 and any(grid.data[3::4])
    occupied(seen["/danger"], facts["danger"])
    occupied(seen["/speed_mask"], facts["speeds"])
    assert len(seen["/speed"]) == bool(facts["speeds"])
    print(json.dumps(counts))


main(*sys.argv[1:])
