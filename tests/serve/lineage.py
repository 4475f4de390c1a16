"""Clicks a thing of a map and follows it back to the messages that it was made from: ADDRESS."""

import json
import sys
from pathlib import Path
from urllib.parse import quote
from urllib.request import urlopen

sys.path.append(str(Path(__file__).parents[1]))
from browser import Browser, until  # noqa: E402


def main(host):
    query = "SELECT map_from_vehicle['x'] AS x, map_from_vehicle['y'] AS y FROM poses ORDER BY stamp LIMIT 1 OFFSET 10"
    (pose,) = json.load(urlopen(f"http://{host}/sql?query={quote(query)}", timeout=60))
    browser = Browser(f"http://{host}/")
    try:
        browser.click([pose["x"], pose["y"]])
        until(lambda: browser.said("document.getElementById('lineage') !== null"))
        browser.said("document.getElementById('lineage').open = true")
        until(lambda: browser.said("document.querySelector('#lineage button') !== null"))
        told = browser.text("lineage")
        assert "keyframes" in told and "/odom" in told and ".mcap" in told, told
        browser.said("document.querySelector('#lineage button').click()")
        until(lambda: "odom_from_vehicle" in browser.text("rows"))
        assert browser.text("fault") == "", browser.text("fault")
        assert "odometry" in browser.said("document.getElementById('sql').value")
    finally:
        browser.close()


main(*sys.argv[1:])
