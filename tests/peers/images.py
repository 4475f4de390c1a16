"""MB per second of an image topic's scan, against only decompressing the same chunks, on one core.

Both run in our scan example: with --raw it reads every chunk and decompresses it, and nothing else, and prints the
decompressed {"bytes": …, "seconds": …}. Another file than the generated one: --file FILE TOPIC; then the topic should be
the only large one in its chunks.
"""

import json
import subprocess

from recordings import recording
from side_by_side import Contender, arguments, race, table


def main():
    """Races the two."""
    parser = arguments(__doc__)
    parser.add_argument("--file", nargs=2, metavar=("FILE", "TOPIC"), help="another recording")
    given = parser.parse_args()
    path, topic = given.file or recording(given.folder, "images")
    raw = [given.scan, path, "--raw"]
    size = json.loads(subprocess.run(raw, stdout=subprocess.PIPE, check=True).stdout)["bytes"]
    contenders = [
        Contender("evermap scan", [given.scan, path, topic, "--threads", "1"]),
        Contender("zstd alone", raw),
    ]
    race(contenders, given.runs, given.core)
    table(f"Image topic {topic}, one core", contenders, size / 1e6, "MB")


if __name__ == "__main__":
    main()
