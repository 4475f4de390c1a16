"""Teaches a park through the page of `evermap serve`, as a person who knows the truth: ADDRESS TRUTH DRAWN ANSWERS LABELS.

Draws the spaces that are farthest from those that are known, by three clicks each, and answers questions by their keys.
LABELS must be there already. Prints what it did. TRUTH is a JSON list of boxes, each a list of its corners in the map."""

import json
import math
import sys
import time
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))
from browser import Browser, until  # noqa: E402


def area(ring):
    return sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(ring, ring[1:] + ring[:1])) / 2


def overlap(one, other):
    """Intersection over union of two convex rings."""
    cut, inside = other, one if area(one) > 0 else one[::-1]
    for a, b in zip(inside, inside[1:] + inside[:1]):
        def left(p):
            return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
        kept = []
        for p, q in zip(cut[-1:] + cut[:-1], cut):
            if (left(p) < 0) != (left(q) < 0):
                share = left(p) / (left(p) - left(q))
                kept.append([p[k] + share * (q[k] - p[k]) for k in (0, 1)])
            if left(q) >= 0:
                kept.append(q)
        cut = kept
    both = abs(area(cut)) if len(cut) > 2 else 0.0
    return both / (abs(area(one)) + abs(area(other)) - both)


def middle(ring):
    return [sum(corner[k] for corner in ring) / len(ring) for k in (0, 1)]


class Person:
    def __init__(self, browser, truth):
        self.browser, self.truth, self.waited = browser, truth, []
        labels = browser.said("evermap.taught.labels")
        self.labels = len(labels)
        self.known = [middle(label["points"]) for label in labels if label["standing"] != "rejected"]

    def saved(self):
        """Waits until the page says so, which is when the act is on the disk."""
        self.labels += 1
        begun = time.monotonic()
        until(lambda: (self.browser.text("saved") + ";").startswith(f"saved; labels: {self.labels};") or failed(self.browser))
        return time.monotonic() - begun

    def draw(self):
        ring = max(self.truth, key=lambda ring: min((math.dist(middle(ring), at) for at in self.known), default=0))
        self.known.append(middle(ring))
        at = json.dumps(middle(ring))
        self.browser.said(f"(v => {{ v.cancelAnimations(); v.setCenter({at}); v.setResolution(0.03); evermap.map.renderSync() }})(evermap.map.getView())")
        self.browser.press("b")
        time.sleep(0.1)
        for corner in ring[:3]:
            self.browser.click(corner)
        self.saved()
        time.sleep(0.4)  # as long as the page takes the last click for a part of the drawing
        self.ranked()

    def ranked(self):
        """Waits for what follows from all that was said."""
        begun = time.monotonic()
        until(lambda: self.browser.said("evermap.taught.revision === evermap.taught.rankedRevision"))
        self.waited.append(time.monotonic() - begun)

    def searched(self):
        until(lambda: self.browser.said("evermap.taught.revision === evermap.taught.rankedRevision && evermap.taught.ranked.isSearched"))

    def answer(self):
        """Answers the question that the page asks; false where it asks none."""
        asked = self.browser.said("(o => o && [o.map_from_label.x, o.map_from_label.y, o.map_from_label.qz, o.map_from_label.qw, o.length_m, o.width_m])(evermap.taught.question)")
        if not asked:
            return False
        x, y, qz, qw, length, width = asked
        yaw = 2 * math.atan2(qz, qw)
        cos, sin = math.cos(yaw) / 2, math.sin(yaw) / 2
        box = [[x + cos * a * length - sin * b * width, y + sin * a * length + cos * b * width] for a, b in [(1, 1), (-1, 1), (-1, -1), (1, -1)]]
        best = max(self.truth, key=lambda ring: overlap(ring, box))
        share = overlap(best, box)
        if 0.5 < share < 0.75:
            self.browser.press("s")
            return True
        if share >= 0.75:
            self.known.append(middle(best))
        self.browser.press("a" if share >= 0.75 else "r")
        self.saved()
        return True


def failed(browser):
    assert browser.text("saved") != "NOT saved", browser.text("fault")
    return False


def main(address, truth, drawn, answers, labels):
    browser = Browser(address)
    try:
        person = Person(browser, json.loads(Path(truth).read_text()))
        assert person.labels == int(labels), f"expected {labels} labels, found {person.labels}"
        for _ in range(int(drawn)):
            person.draw()
        for _ in range(int(answers)):
            if not person.answer():
                break
            person.ranked()
        person.searched()
        waited = sorted(person.waited)
        print(json.dumps({"labels": person.labels, "ranked_s": [waited[len(waited) // 2], waited[-1]], "question": browser.text("question")}))
    finally:
        browser.close()


main(*sys.argv[1:])
