"""Says things of a map by HTTP: read-only|taught|later|dawn|dusk|painted|people|blind|missed|learnt ADDRESS; by its page: page|accepted|answered|drawn ADDRESS."""

import json
import struct
import sys
from pathlib import Path
from urllib.error import HTTPError, URLError
from urllib.parse import urlencode
from urllib.request import Request, urlopen


def ask(address, said=None, kind="application/json", **headers):
    body = None if said is None else said if isinstance(said, bytes) else json.dumps(said).encode()
    if body is not None:
        headers["content-type"] = kind
    try:
        answer = urlopen(Request(address, data=body, headers=headers), timeout=30)
        return answer.status, json.load(answer)
    except HTTPError as error:
        text = error.read()
        return error.code, json.loads(text) if text[:1] == b"{" else text


def feature(kind, ring, standing="drawn", shape="Polygon"):
    coordinates = [ring + ring[:1]] if shape == "Polygon" else ring
    return {"type": "Feature", "geometry": {"type": shape, "coordinates": coordinates}, "properties": {"kind": kind, "standing": standing}}


BOX = [[1, 1], [6, 1], [6, 3], [1, 3]]


def pictures(host):
    """The images that a map of one camera has, in the order of time."""
    query = b"SELECT session, camera, CAST(CAST(stamp AS BIGINT) AS TEXT) AS stamp FROM pictures ORDER BY stamp"
    return ask(f"http://{host}/sql", query, "text/plain")[1]


def region(kind, ring, **more):
    made = feature(kind, ring)
    made["properties"].update(more)
    return made


def painted(host):
    """Paints the upper part of a few images as sky, the lower as ground; all else is refused."""
    here = f"http://{host}/teach/street"
    images = pictures(host)
    of = lambda one: f"{here}?{urlencode(one)}"
    sky = region("sky", [[0, 0], [256, 0], [256, 34], [0, 34]])
    ground = region("ground", [[0, 50], [256, 50], [256, 83], [0, 83]])
    for one in images[:3]:
        assert ask(of(one))[1]["labels"] == []
        status, said = ask(of(one), {"author": "ada", "features": {"type": "FeatureCollection", "features": [sky, ground]}})
        assert status == 200 and said["saved"] == 2, said
        assert [label["kind"] for label in said["labels"]] == ["sky", "ground"], said
        assert said["classes"] == ["ground", "sky"], said
    # What is painted over lies on top, is taken back, and removed by another.
    line = feature("kerb", [[0, 42], [256, 42]], shape="LineString")
    line["properties"]["brush_px"] = 4
    said = ask(of(one), {"author": "bob", "features": line})[1]
    label = said["labels"][-1]
    assert (label["kind"], label["author"], label["shape"], label["brush_px"]) == ("kerb", "bob", "polyline", 4), said
    again = region("road", ground["geometry"]["coordinates"][0][:-1])
    said = ask(of(one), {"author": "ada", "features": again})[1]
    assert [label["kind"] for label in said["labels"]] == ["sky", "kerb", "road"], said
    said = ask(of(one), {"author": "ada", "features": said["undo"]})[1]
    assert sorted(label["kind"] for label in said["labels"]) == ["ground", "kerb", "sky"], said
    removed = {"type": "Feature", "id": label["label"], "geometry": None, "properties": {"standing": "removed"}}
    said = ask(of(one), {"author": "ada", "features": removed})[1]
    assert [label["kind"] for label in said["labels"]] == ["sky", "ground"], said

    good, before = region("sky", [[1, 1], [9, 1], [9, 9]]), ask(of(one))[1]
    elsewhere = [
        ({"session": "nobody"}, "the map has no session nobody"), ({"camera": "rear"}, "no image of rear"), ({"stamp": "7"}, "at 7 ns"),
        ({"stamp": "x"}, None),
    ]
    for other, text in elsewhere:
        status, said = ask(of({**one, **other}), {"author": "ada", "features": good})
        assert status == 400 and (text is None or text in said["error"]), (other, said)
    status, said = ask(f"{here}?session={one['session']}", {"author": "ada", "features": good})
    assert status == 400 and "session, camera and stamp" in said["error"], said
    for bad, text in [
        (region("sky", [[1, 1], [300, 1], [9, 9]]), "expected points within the image, 256 x 83 px, found (300, 1)"),
        (region("sky", [[0, 0], [4, 4], [4, 0], [0, 4]]), "that does not cross itself, found that it does at (2, 2)"),
        (region("sky", [[1, 1], [9, 1]]), "expected 3 to 4096 points, found 2"),
        (region("sky", [[k % 250, k % 80] for k in range(5000)]), "feature with more than 4096 points"),
        (region("", [[1, 1], [9, 1], [9, 9]]), "expected a class as kind"),
        (region("sky", [[1, 1], [9, 1], [9, 9]], standing="accepted"), "expected drawn or removed, found accepted"),
        (feature("sky", [[1, 1], [9, 1]], shape="LineString"), "expected brush_px of a line"),
        ({**line, "properties": {"kind": "sky", "brush_px": 1e9}}, "expected a brush of 1 to 256 px"),
        ({**good, "geometry": None}, "expected a polygon or a line, found none"),
        ({**removed, "id": "nothing"}, "expected a label of this image to remove"),
    ]:
        status, said = ask(of(one), {"author": "ada", "features": bad})
        assert status == 400 and text in said["error"] and said["next"] == "nothing was saved", (bad, said)
    assert ask(of(one))[1] == before
    # There is nothing in the map that a label could be tied to, and none is there.
    status, said = ask(here, {"author": "ada", "features": feature("spot", BOX)})
    assert status == 400 and "no poses" in said["error"], said
    assert ask(here)[1]["labels"] == []


def page(host):
    """Draws an area on an image, and a line by a brush, as a person does with the page."""
    sys.path.append(str(Path(__file__).parents[1]))
    from browser import Browser, until

    one = pictures(host)[-1]
    browser = Browser(f"http://{host}/")
    try:
        # A kind may have a slash, or be what a folder is called: what may be of it is asked for all the same.
        kind = "document.getElementById('kind')"
        for name in ("bay/left", ".."):
            browser.said(f"evermap.taught.ranked = undefined; {kind}.value = '{name}'; {kind}.dispatchEvent(new Event('change'))")
            until(lambda: browser.said("evermap.taught.ranked !== undefined"))
            assert browser.text("fault") == "", name
        browser.said("document.getElementById('paint-open').click()")
        until(lambda: browser.said("evermap.painting.isReady"))
        browser.said("document.getElementById('paint-at').value = 1000; document.getElementById('paint-at').dispatchEvent(new Event('change'))")
        until(lambda: browser.said(f"evermap.painting.at?.stamp === '{one['stamp']}' && evermap.painting.isReady"))
        # The class that another image has is offered, the first one by its key.
        assert browser.said("evermap.painting.classes") == ["ground", "sky"]
        browser.press("2")
        view = "evermap.painting.map"
        corners = [[20, 10], [220, 10], [220, 30]]
        for x, y in corners:
            browser.click([x, 83 - y], view)
        browser.press("Enter")
        until(lambda: "saved; drawn on this image: 1" in browser.text("paint-saved"))
        browser.press("1")
        browser.press("b")
        browser.drag([[x, 83 - 70] for x in range(30, 230, 20)], view)
        until(lambda: "saved; drawn on this image: 2" in browser.text("paint-saved"))
        # Escape ends a drawing, and nothing is said; undo takes the last act back.
        browser.press("p")
        browser.click([40, 40], view)
        browser.press("Escape")
        assert browser.said("evermap.painting.isOpen") and browser.text("fault") == ""
        browser.press("u")
        until(lambda: "drawn on this image: 1" in browser.text("paint-saved"))
        browser.press("Escape")
        assert not browser.said("evermap.painting.isOpen")
    finally:
        browser.close()
    (label,) = ask(f"http://{host}/teach/street?{urlencode(one)}")[1]["labels"]
    assert label["kind"] == "sky" and label["shape"] == "polygon" and len(label["points"]) == 3, label
    off = [abs(a - b) for found, meant in zip(label["points"], corners) for a, b in zip(found, meant)]
    assert max(off) < 0.5, label


def accepted(host):
    """Accepts what the map says of an image, one area or all; removes what another person paints there meanwhile."""
    sys.path.append(str(Path(__file__).parents[1]))
    from browser import Browser, until

    one = pictures(host)[-2]
    here = f"http://{host}/teach/street?{urlencode(one)}"
    assert ask(here)[1]["labels"] == []
    browser = Browser(f"http://{host}/")
    lying = "evermap.painting.lying.length"
    try:
        browser.said(f"evermap.painting.open({json.dumps(one)}), 0")
        until(lambda: browser.said("evermap.painting.isReady"))
        browser.press("a")
        until(lambda: "saved" in browser.text("paint-saved"))
        said = ask(here)[1]["labels"]
        assert {label["kind"] for label in said} == {"sky", "ground"}, said
        assert browser.said(lying) == len(said) == browser.said("evermap.painting.areas().length")
        # Later paint lies over earlier, so the largest area comes first.
        xs, ys = ([at[axis] for at in said[0]["points"]] for axis in (0, 1))
        assert (max(xs) - min(xs)) * (max(ys) - min(ys)) >= 0.3 * 256 * 83, said[0]
        browser.press("u")
        until(lambda: browser.said(lying) == 0)
        browser.press("t")
        browser.click([128, 83 - 2], "evermap.painting.map")
        until(lambda: browser.said(lying) > 0)
        assert ask(here)[1]["labels"][0]["kind"] == "sky"
        before = browser.said(lying)
        said = ask(here, {"author": "bob", "features": region("kerb", [[100, 30], [150, 30], [150, 60], [100, 60]])})
        assert said[0] == 200, said
        until(lambda: browser.said(lying) == before + 1)
        browser.press("x")
        browser.click([125, 83 - 45], "evermap.painting.map")
        until(lambda: browser.said(lying) == before)
        assert browser.text("fault") == ""
    finally:
        browser.close()
    assert "kerb" not in {label["kind"] for label in ask(here)[1]["labels"]}


def asked(host):
    """The questions about people that are open, as the map numbers them, and all that is said of them."""
    status, said = ask(f"http://{host}/teach/street/person?revision=0&searched=true")
    assert status == 200 and said["unplaced"] == 0 and said["is_searched"], said
    return [one["question"] for one in said["hypotheses"]], said["hypotheses"]


def part(host, image, around):
    """What the server answers that is asked for the part of an image: status and size of a PNG, or what it says."""
    try:
        with urlopen(f"http://{host}/images?{urlencode({**image, 'around': around})}", timeout=30) as answer:
            png = answer.read()
            assert answer.headers["content-type"] == "image/png" and png[:8] == b"\x89PNG\r\n\x1a\n"
            return 200, struct.unpack(">II", png[16:24])
    except HTTPError as error:
        said = json.loads(error.read())
        return error.code, " ".join(said.get(word) or "" for word in ("place", "error", "next"))


def of_person(one, standing, **image):
    x, y = (one["map_from_label"][axis] for axis in "xy")
    made = feature("person", [[x + 0.2, y + 0.2], [x - 0.2, y + 0.2], [x - 0.2, y - 0.2], [x + 0.2, y - 0.2]], standing)
    made["properties"]["image"] = {**one["image"], **image}
    return made


def people(host):
    """Answers the first two questions about people; one answer is taken back and given again. All else is refused."""
    here, images = f"http://{host}/teach/street", pictures(host)
    all_of_them = list(range(1, len(images) + 1))
    numbers, open_ones = asked(host)
    assert numbers == all_of_them and [one["image"] for one in open_ones] == images, open_ones
    first, second = open_ones[:2]
    assert (first["probability"], first["reason"], first["rectangle"]) == (0.5, "uncertain", [100, 30, 110, 60]), first

    # 16 px on each side of the rectangle, as far as the image of 256 x 83 px goes.
    assert part(host, first["image"], "100,30,110,60") == (200, (43, 63))
    assert part(host, first["image"], "-5,-5,5,5") == (200, (22, 22))
    for around, text in [("1,2,3", "expected a rectangle as"), ("9,9,1,1", "expected a rectangle as"), ("900,1,950,9", "in an image of 256 × 83 px")]:
        status, said = part(host, first["image"], around)
        assert status == 400 and text in said, (around, said)
    status, said = part(host, {**first["image"], "stamp": "7"}, "1,1,9,9")
    assert status == 400 and "no image of" in said, said

    yes = of_person(first, "accepted")
    status, said = ask(here, {"author": "ada", "features": yes})
    assert status == 200 and said["saved"] == 1, said
    assert asked(host)[0] == all_of_them[1:]
    assert ask(here, {"author": "ada", "features": yes})[1]["saved"] == 0
    assert ask(here, {"author": "ada", "features": said["undo"]})[1]["saved"] == 1
    assert asked(host)[0] == all_of_them
    status, said = ask(here, {"author": "ada", "features": yes})
    assert said["saved"] == 1, said
    # Removed by another, and taken back: it is still about its image.
    (label,) = said["labels"]
    removed = {"type": "Feature", "id": label["label"], "geometry": None, "properties": {"kind": "person", "standing": "removed"}}
    said = ask(here, {"author": "bob", "features": removed})[1]
    assert asked(host)[0] == all_of_them
    assert ask(here, {"author": "bob", "features": said["undo"]})[1]["saved"] == 1
    assert asked(host)[0] == all_of_them[1:]
    # A stamp may be a number, too.
    no = of_person(second, "rejected", stamp=int(second["image"]["stamp"]))
    assert ask(here, {"author": "ada", "features": no})[1]["saved"] == 1
    for image, text in [({"camera": None}, "without session, stamp (ns) and camera"), ({"stamp": "soon"}, "without session, stamp (ns) and camera"),
                        ({"camera": "nobody"}, "an image that the map does not have"), ({"stamp": "7"}, "no vehicle pose"), ({"session": "nobody"}, "no vehicle pose")]:
        status, said = ask(here, {"author": "ada", "features": of_person(open_ones[2], "accepted", **image)})
        assert status == 400 and text in said["error"] and said["next"] == "nothing was saved", (image, said)
    assert asked(host)[0] == all_of_them[2:]


def answered(host):
    """Answers the third and the fifth question with the page, and skips the fourth."""
    sys.path.append(str(Path(__file__).parents[1]))
    from browser import Browser, until

    numbers, _ = asked(host)
    browser = Browser(f"http://{host}/")
    shown = lambda: browser.said("evermap.taught.question?.question")
    try:
        kind = "document.getElementById('kind')"
        browser.said(f"{kind}.value = 'person'; {kind}.dispatchEvent(new Event('change'))")
        until(lambda: shown() == 3)
        assert browser.text("question").startswith("Is this a person? 50 %: uncertain"), browser.text("question")
        until(lambda: browser.said("!document.getElementById('seen-image').hidden && document.getElementById('seen-image').naturalWidth") == 43)
        browser.press("a")
        until(lambda: "saved; labels: 3" in browser.text("saved"))
        until(lambda: shown() == 4)
        browser.press("s")
        until(lambda: shown() == 5)
        browser.press("r")
        until(lambda: "saved; labels: 4" in browser.text("saved"))
        # What was skipped does not come again.
        until(lambda: shown() == 6 and browser.said("evermap.taught.asked.length") == len(numbers) - 3)
        assert browser.text("fault") == ""
    finally:
        browser.close()
    assert asked(host)[0] == [4, *numbers[3:]]


def blind(host):
    """What was answered is not asked again in the next version. Where the log is gone, questions are there, and why their images are not."""
    numbers, open_ones = asked(host)
    assert numbers == [4, *range(6, len(pictures(host)) + 1)], numbers
    status, said = part(host, open_ones[0]["image"], "100,30,110,60")
    assert status >= 400 and "visit_a" in said, (status, said)


def shared(one, other):
    """What two boxes share, as a part of what they cover together."""
    area = lambda left, top, right, bottom: max(right - left, 0) * max(bottom - top, 0)
    both = area(max(one[0], other[0]), max(one[1], other[1]), min(one[2], other[2]), min(one[3], other[3]))
    return both / (area(*one) + area(*other) - both)


# Around somebody who stands some 5 m ahead.
AHEAD = [125, 42, 131, 56]


def missed(host):
    """Draws somebody on the first image, takes them back, and draws them again; on the sixth a box accepts who is asked about. All else is refused."""
    here, images = f"http://{host}/teach/street", pictures(host)
    one, sixth = images[0], images[5]
    of = lambda image: f"{here}/person/boxes?{urlencode(image)}"
    draw = lambda boxes, image=one: ask(of(image), {"author": "ada", "boxes": boxes})
    status, before = ask(of(one))
    assert status == 200 and before["labels"] == [] and before["waiting"] == 0, before
    status, said = draw([AHEAD])
    assert status == 200 and said["saved"] == 1 and said["waiting"] == 1, said
    (label,) = said["labels"]
    assert (label["standing"], label["author"]) == ("drawn", "ada") and shared(label["box"], AHEAD) > 0.5, label
    assert draw([AHEAD])[1]["saved"] == 0
    assert ask(of(images[1]))[1]["labels"] == []
    # Taken back, and drawn again: nobody else is meant.
    assert ask(here, {"author": "ada", "features": said["undo"]})[1]["saved"] == 1
    gone = ask(of(one))[1]
    assert gone["labels"] == [] and gone["waiting"] == 0, gone
    (again,) = draw([AHEAD])[1]["labels"]
    assert again == label, again
    # A box around who is asked about answers the question, at the place that is asked about.
    assert 6 in asked(host)[0]
    status, said = draw([[101, 31.5, 110, 60]], sixth)
    assert status == 200 and said["waiting"] == 2, said
    (answer,) = said["labels"]
    assert (answer["standing"], answer["box"]) == ("accepted", [100.5, 30.5, 110.5, 60.5]), answer
    assert asked(host)[0] == [number + 1 for number in range(len(images)) if number != 5]
    status, open_ones = ask(f"{here}/person")
    assert status == 200 and open_ones["waiting"] == 2, open_ones

    before = ask(of(one))[1]
    for boxes, text in [
        ([[300, 1, 310, 9]], "box 0: expected a box within the image, 256 x 83 px, found [300"), ([[-1, 1, 10, 9]], "expected a box within the image"),
        ([[9, 5, 9, 20]], "expected a box whose right is beyond its left"), ([[20, 5, 9, 20]], "expected a box whose right is beyond its left"),
        ([AHEAD, [9, 5, 12, 5]], "box 1: expected a box whose right is beyond its left"),
        ([[120, 1, 128, 6]], "that no one standing near the vehicle would fill"),
        ([], "expected 1 to 100 boxes, found 0"), ([AHEAD] * 101, "expected 1 to 100 boxes, found 101"),
    ]:
        status, said = draw(boxes)
        assert status == 400 and text in said["error"] and said["next"] == "nothing was saved", (boxes, said)
    for boxes in [7, None, [[1, 2, 3]], [["1", 2, 3, 4]], [[1, 2, None, 4]]]:
        assert draw(boxes)[0] in (400, 422), boxes
    for other, text in [({"session": "nobody"}, "the map has no session nobody"), ({"camera": "rear"}, "no image of rear"), ({"stamp": "7"}, "at 7 ns")]:
        for status, said in (draw([AHEAD], {**one, **other}), ask(of({**one, **other}))):
            assert status == 400 and text in said["error"], (other, said)
    for address, text in [(f"{here}/person/boxes", "expected session, camera and stamp of an image"), (f"{here}/crossing/boxes?{urlencode(one)}", "expected the kind person")]:
        status, said = ask(address, {"author": "ada", "boxes": [AHEAD]})
        assert status == 400 and text in said["error"], said
    assert ask(of(one))[1] == before


def drawn(host):
    """Draws somebody on the second image with the page, takes them back, and draws them again."""
    sys.path.append(str(Path(__file__).parents[1]))
    from browser import Browser, until

    one = pictures(host)[1]
    browser = Browser(f"http://{host}/")
    said = lambda: browser.said("evermap.missed.isReady && evermap.missed.said.length")
    draw = lambda: browser.drag([[AHEAD[0], 83 - AHEAD[1]], [128, 83 - 50], [AHEAD[2], 83 - AHEAD[3]]], "evermap.missed.map")
    try:
        assert browser.said("document.getElementById('people-open').hidden")
        kind = "document.getElementById('kind')"
        browser.said(f"{kind}.value = 'person'; {kind}.dispatchEvent(new Event('change'))")
        until(lambda: browser.said("evermap.taught.question?.question") == 1)
        browser.press("s")
        until(lambda: browser.said("evermap.taught.question?.question") == 2)
        # The image of the question opens.
        browser.press("w")
        until(lambda: browser.said("evermap.missed.isReady"))
        assert browser.said("evermap.missed.at.stamp") == one["stamp"]
        draw()
        until(lambda: said() == 1)
        until(lambda: browser.text("people-waiting") == "3 answers about people wait for the next run of the plan people")
        browser.press("u")
        until(lambda: said() == 0)
        draw()
        until(lambda: said() == 1)
        # A click is no box.
        browser.click([200, 40], "evermap.missed.map")
        # The next image that is asked about, and back: what was drawn is there.
        browser.press("n")
        until(lambda: said() == 0 and browser.text("people-name").startswith("3 of "))
        browser.press("ArrowLeft")
        until(lambda: said() == 1 and browser.text("people-name").startswith("2 of "))
        assert browser.text("fault") == ""
        browser.press("Escape")
        assert not browser.said("evermap.missed.isOpen")
        assert browser.text("waiting").startswith("3 answers about people wait")
    finally:
        browser.close()
    (label,) = ask(f"http://{host}/teach/street/person/boxes?{urlencode(one)}")[1]["labels"]
    assert label["standing"] == "drawn" and shared(label["box"], AHEAD) > 0.5, label


def learnt(host):
    """The map has learnt from all answers, and says of the first image what was said."""
    said = ask(f"http://{host}/teach/street/person/boxes?{urlencode(pictures(host)[0])}")[1]
    assert said["waiting"] == 0 and [label["standing"] for label in said["labels"]] == ["drawn"], said
    assert shared(said["labels"][0]["box"], AHEAD) > 0.5, said


def main(what, host):
    others = {
        "painted": painted, "page": page, "accepted": accepted, "people": people, "answered": answered, "blind": blind,
        "missed": missed, "drawn": drawn, "learnt": learnt,
    }
    if what in others:
        return others[what](host)
    here = f"http://{host}/teach"
    if what in ("dawn", "dusk"):
        row = 4 * len(ask(f"{here}/lot")[1]["labels"])
        ring = [[0, row], [3, row], [3, row + 2], [0, row + 2]]
        status, said = ask(f"{here}/lot", {"author": "ada", "features": feature(what, ring)})
        assert status == 200 and said["saved"] == 1, said
        return
    status, may = ask(here)
    assert status == 200
    if what == "read-only":
        assert may["teach"] is False, may
        for address in [f"{here}/lot", f"{here}/lot/spot"]:
            assert ask(address)[0] == 400
        status, said = ask(f"{here}/lot", {"features": feature("spot", BOX)})
        assert status == 400 and "--teach" in said["next"], said
        return
    assert may["teach"] is True and may["author_is_known"] is False, may
    if what == "later":
        status, said = ask(f"{here}/lot", {"author": "ada", "features": feature("late", [[9, 1], [12, 1], [12, 3], [9, 3]])})
        assert status == 200 and said["version"] == 3 and len(said["labels"]) == 3, said
        return

    status, said = ask(f"{here}/lot", {"author": "ada", "features": feature("spot", BOX)})
    assert status == 200 and said["saved"] == 1 and len(said["labels"]) == 1, said
    (label,) = said["labels"]
    assert (label["kind"], label["standing"], label["author"], label["shape"]) == ("spot", "drawn", "ada", "box"), label
    # The same again is nothing new.
    assert ask(f"{here}/lot", {"author": "ada", "features": feature("spot", BOX)})[1]["saved"] == 0
    # Rejected by another, and taken back: as it was, and by whom.
    judged = {"type": "Feature", "id": label["label"], "geometry": None, "properties": {"kind": "spot", "standing": "rejected"}}
    said = ask(f"{here}/lot", {"author": "bob", "features": judged})[1]
    assert said["labels"][0]["standing"] == "rejected" and said["labels"][0]["author"] == "bob"
    # Drawn again where it is, without a geometry of its own.
    again = {**judged, "properties": {"kind": "spot", "standing": "drawn"}}
    back = ask(f"{here}/lot", {"author": "ada", "features": again})[1]
    assert back["saved"] == 1 and back["labels"][0]["standing"] == "drawn", back
    off = [abs(a - b) for found, meant in zip(back["labels"][0]["points"], label["points"]) for a, b in zip(found, meant)]
    assert len(off) == 12 and max(off) < 1e-6, back
    assert ask(f"{here}/lot", {"author": "bob", "features": judged})[1]["saved"] == 1
    said = ask(f"{here}/lot", {"author": "ada", "features": said["undo"]})[1]
    assert said["labels"][0]["standing"] == "drawn", said
    # Removed, and taken back.
    judged["properties"]["standing"] = "removed"
    said = ask(f"{here}/lot", {"author": "ada", "features": judged})[1]
    assert said["labels"] == []
    said = ask(f"{here}/lot", {"author": "ada", "features": said["undo"]})[1]
    assert len(said["labels"]) == 1 and said["labels"][0]["label"] == label["label"], said
    said = ask(f"{here}/lot", {"author": "bob", "features": feature("crossing", [[0, 8], [3, 9], [5, 8]], shape="LineString")})[1]
    assert {label["shape"] for label in said["labels"]} == {"box", "polyline"}, said
    # There is no image to learn from, and nothing is found.
    status, searched = ask(f"{here}/lot/spot?revision={said['revision']}&searched=true")
    assert status == 200 and searched["hypotheses"] == [] and searched["revision"] >= said["revision"], searched

    before = ask(f"{here}/lot")[1]
    for author in ["../ada", "a/b", "", "  ", "..", "x" * 65, "\U00020000" * 64, "a\u0000b", ".hidden"]:
        assert ask(f"{here}/lot", {"author": author, "features": feature("spot", [[20, 1], [22, 1], [22, 3]])})[0] == 400, author
    for site in ["..", "nowhere", "%2e%2e%2flot", "lot%2f.."]:
        assert ask(f"{here}/{site}", {"author": "ada", "features": feature("spot", BOX)})[0] in (400, 404), site
    status, said = ask(f"{here}/nowhere")
    assert status == 400 and said["error"] == 'no site "nowhere" in this map' and said["next"].startswith("its sites: "), said
    crossed = feature("spot", [[0, 0], [4, 4], [4, 0], [0, 4]])
    endless = feature("spot", [[0, 0], [4, 0], [4, 1e300]])
    for said in [crossed, endless, {"type": "Feature"}, 7, [], {"type": "FeatureCollection", "features": 3}]:
        status, answer = ask(f"{here}/lot", {"author": "ada", "features": said})
        assert status == 400 or answer["saved"] == 0, (said, answer)
    for body, kind in [(b"{", "application/json"), (json.dumps({"features": feature("spot", [[30, 1], [33, 1], [33, 3]])}).encode(), "text/plain")]:
        assert ask(f"{here}/lot", body, kind)[0] in (400, 415), (body, kind)
    huge = json.dumps({"author": "ada", "features": feature("spot", [[k, k % 7] for k in range(400_000)])}).encode()
    try:
        status, said = ask(f"{here}/lot", huge)
        assert status == 413 and "a request of at most 2 MiB" in said["error"], said
    except URLError as ended:
        # The server need not read to the end what is too long.
        assert isinstance(ended.reason, (BrokenPipeError, ConnectionResetError)), ended
    assert ask(f"{here}/lot", {"author": "ada", "features": feature("spot", BOX)}, Host="evil.example")[0] == 403
    assert ask(f"{here}/lot")[1]["labels"] == before["labels"]


main(*sys.argv[1:])
