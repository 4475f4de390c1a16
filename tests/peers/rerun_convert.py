"""Time from an MCAP file to a table that can be queried: `rerun mcap convert` against `evermap sql --format parquet`.

All are whole programs on all cores, start and disk included, and convert every topic of the file: rerun to one .rrd,
ours to one file a topic (Parquet, Arrow IPC), one program start each. The last row is what a query on the log itself
takes, which needs no conversion. By default rerun leaves fields out of the types that it knows
(an Imu's covariances); with its reflection decoder it keeps all of them, as we do.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from mcap.reader import make_reader
from recordings import recording
from side_by_side import Contender, arguments, race, table


def topics(path):
    """The topics of a recording, and how many messages it has."""
    with open(path, "rb") as file:
        summary = make_reader(file).get_summary()
    return sorted({channel.topic for channel in summary.channels.values()}), summary.statistics.message_count


def ours(evermap, path, folder, kind):
    """One `evermap sql` a topic, in one shell."""
    script = ["set -e"]
    for number, topic in enumerate(topics(path)[0]):
        query = f'SELECT * FROM "{topic}"'
        script.append(f"'{evermap}' sql --sessions '{path}' --format {kind} --out '{folder}/{number}.{kind}' '{query}'")
    return ["sh", "-c", "\n".join(script)]


def main():
    """Races the two on the generated recordings and on those given."""
    parser = arguments(__doc__)
    parser.add_argument("files", nargs="*", help="further recordings")
    given = parser.parse_args()
    rerun = Path(sys.executable).parent / "rerun"
    with tempfile.TemporaryDirectory() as temporary:
        output = Path(temporary) / "output"

        def fresh():
            shutil.rmtree(output, ignore_errors=True)
            output.mkdir()

        # rerun reports usage to its makers unless told not to; it is told in a folder that goes away again.
        quiet = {"XDG_CONFIG_HOME": temporary, "HOME": temporary}
        subprocess.run([rerun, "analytics", "disable"], env={**os.environ, **quiet}, check=True, capture_output=True)
        for path in [recording(given.folder, kind)[0] for kind in ("imu", "odometry", "long_imu")] + given.files:
            convert = [str(rerun), "mcap", "convert", path, "-o", f"{output}/out.rrd"]
            all_fields = [*convert, "--decoder", "ros2_reflection"]
            latest = f'SELECT max(header[\'stamp\']), count(*) FROM "{topics(path)[0][0]}"'
            ask = [given.evermap, "sql", "--sessions", path, latest]
            contenders = [
                Contender("evermap, Parquet", ours(given.evermap, path, output, "parquet"), inner=False, fresh=fresh),
                Contender("evermap, Arrow IPC", ours(given.evermap, path, output, "arrow"), inner=False, fresh=fresh),
                Contender("rerun mcap convert", convert, inner=False, fresh=fresh, environment=quiet),
                Contender("rerun mcap convert, all fields", all_fields, inner=False, fresh=fresh, environment=quiet),
                Contender("evermap, a query on the log", ask, inner=False),
            ]
            race(contenders, given.runs)
            table(f"{Path(path).name} to a queryable table, all cores", contenders, topics(path)[1], "messages")


if __name__ == "__main__":
    main()
