"""How soon a served map is seen: ADDRESS of `evermap serve`, with --teach or without. No peer: the goal is one second.

From the page being asked for, with nothing kept by the browser, to the first frame with tiles, and to all that is shown at first."""

import sys
import time
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))
from browser import Browser, until  # noqa: E402

RUNS = 6
DRAWN = """(() => {
  const canvas = document.querySelector("#map canvas");
  if (!canvas) return false;
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let seen = 0;
  for (let at = 3; at < data.length; at += 400) seen += data[at] > 0;
  return seen > 200;
})()"""


class Page(Browser):
    def open(self, address):
        self.send("Network.enable")
        for _ in range(RUNS):
            self.send("Page.navigate", url="about:blank")
            time.sleep(0.5)
            self.send("Network.clearBrowserCache")
            begun = time.perf_counter()
            self.send("Page.navigate", url=address)
            until(lambda: self.said(DRAWN))
            drawn = time.perf_counter() - begun
            until(lambda: self.said("document.getElementById('busy')?.textContent === ''"))
            print(f"first picture {drawn:.2f} s, all {time.perf_counter() - begun:.2f} s")


Page(sys.argv[1]).close()
