"""Says things of a map by HTTP: read-only|taught|later ADDRESS."""

import json
import sys
from urllib.error import HTTPError, URLError
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


def main(what, host):
    here = f"http://{host}/teach"
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
    status, learnt = ask(f"{here}/lot/spot?revision={said['revision']}&searched=true")
    assert status == 200 and learnt["hypotheses"] == [] and learnt["revision"] >= said["revision"], learnt

    before = ask(f"{here}/lot")[1]
    for author in ["../ada", "a/b", "", "..", "x" * 65, "a\u0000b", ".hidden"]:
        assert ask(f"{here}/lot", {"author": author, "features": feature("spot", [[20, 1], [22, 1], [22, 3]])})[0] == 400, author
    for site in ["..", "nowhere", "%2e%2e%2flot", "lot%2f.."]:
        assert ask(f"{here}/{site}", {"author": "ada", "features": feature("spot", BOX)})[0] in (400, 404), site
    crossed = feature("spot", [[0, 0], [4, 4], [4, 0], [0, 4]])
    endless = feature("spot", [[0, 0], [4, 0], [4, 1e300]])
    for said in [crossed, endless, {"type": "Feature"}, 7, [], {"type": "FeatureCollection", "features": 3}]:
        status, answer = ask(f"{here}/lot", {"author": "ada", "features": said})
        assert status == 400 or answer["saved"] == 0, (said, answer)
    for body, kind in [(b"{", "application/json"), (json.dumps({"features": feature("spot", [[30, 1], [33, 1], [33, 3]])}).encode(), "text/plain")]:
        assert ask(f"{here}/lot", body, kind)[0] in (400, 415), (body, kind)
    huge = json.dumps({"author": "ada", "features": feature("spot", [[k, k % 7] for k in range(400_000)])}).encode()
    try:
        assert ask(f"{here}/lot", huge)[0] in (400, 413)
    except URLError as ended:
        # The server need not read to the end what is too long.
        assert isinstance(ended.reason, (BrokenPipeError, ConnectionResetError)), ended
    assert ask(f"{here}/lot", {"author": "ada", "features": feature("spot", BOX)}, Host="evil.example")[0] == 403
    assert ask(f"{here}/lot")[1]["labels"] == before["labels"]


main(*sys.argv[1:])
