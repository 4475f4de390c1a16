"""Runs one function of a plan: tables in, a table out, as Arrow streams between two pipes.

A message is a line of JSON with its length before it (4 bytes), then the tables that the line names, each as an Arrow
stream with its length before it (8 bytes); numbers are little-endian. The first message has the code. It is answered
with the digest of the environment; every other one with rows and counts of what was left out, or with an error. An
answer has the number of its message.
"""

import hashlib
import importlib.metadata
import inspect
import json
import linecache
import os
import pathlib
import platform
import queue
import signal
import struct
import sys
import threading
import traceback
import types
import urllib.parse
import urllib.request

# What a function can import is installed, and so in the digest of the environment.
sys.path[:] = [folder for folder in sys.path if folder]
HERE = "<string>"  # this text
LONGEST_ERROR = 10_000  # characters


class Refused(Exception):
    """What is wrong with the code, or with what it returned: one sentence for the person who wrote it."""


def read_exactly(stream, count):
    data = stream.read(count)
    if len(data) < count:
        raise EOFError
    return data


def read_message(stream):
    (length,) = struct.unpack("<I", read_exactly(stream, 4))
    header = json.loads(read_exactly(stream, length))
    tables = []
    for _ in header.get("tables", []):
        (length,) = struct.unpack("<Q", read_exactly(stream, 8))
        tables.append(read_exactly(stream, length))
    return header, tables


def write_message(stream, header, table=None):
    line = json.dumps(header).encode()
    stream.write(struct.pack("<I", len(line)) + line)
    if table is not None:
        stream.write(struct.pack("<Q", len(table)))
        stream.write(table)
    stream.flush()


def sources(folder):
    """The code of a package that is installed as a link to its folder."""
    for path, folders, files in os.walk(folder):
        folders[:] = sorted(f for f in folders if not f.startswith(".") and f not in ("__pycache__", "site-packages"))
        for name in sorted(files):
            if name.endswith((".py", ".so")):
                yield pathlib.Path(path, name)


def environment():
    """The digest of all that decides what code does: the interpreter and what is installed."""
    digest = hashlib.sha256()
    for fact in (platform.python_implementation(), platform.python_version(), platform.machine()):
        digest.update(fact.encode() + b"\n")
    installed = {}
    for found in importlib.metadata.distributions():
        name = found.metadata["Name"]
        if name:
            installed.setdefault(name.lower(), found)
    for name in sorted(installed):
        found = installed[name]
        digest.update(f"{name}=={found.version}\n{found.read_text('RECORD')}\n".encode())
        link = json.loads(found.read_text("direct_url.json") or "{}")
        if link.get("dir_info", {}).get("editable"):
            folder = urllib.request.url2pathname(urllib.parse.urlparse(link["url"]).path)
            for source in sources(folder):
                digest.update(source.read_bytes())
    return digest.hexdigest()


def load(request):
    """The function, which takes the tables and parameters that the step gives."""
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        raise Refused(f"{sys.executable} has no pyarrow; install it there, or name another interpreter with {sys.argv[1]}") from None
    file, name, code = request["file"], request["function"], request["code"]
    module = types.ModuleType("step")
    module.__file__ = file
    sys.modules["step"] = module
    linecache.cache[file] = (len(code), None, code.splitlines(True), file)
    exec(compile(code, file, "exec"), module.__dict__)
    function = getattr(module, name, None)
    if not callable(function):
        known = [n for n, value in vars(module).items() if inspect.isfunction(value) and value.__module__ == "step"]
        found = ", ".join(known) or "none"
        raise Refused(f"expected a function {name}, found {found}")
    try:
        inspect.signature(function).bind(**dict.fromkeys([*request["ports"], *request["params"]]))
    except TypeError as error:
        raise Refused(f"{name}{inspect.signature(function)} does not take what the step gives: {error}") from None
    return function


def table_of(found):
    import pyarrow

    if isinstance(found, (list, tuple, types.GeneratorType)):
        found = pyarrow.Table.from_batches(found)
    try:
        return pyarrow.table(found)
    except (TypeError, ValueError, pyarrow.ArrowInvalid) as error:
        kind = type(found).__name__
        raise Refused(f"expected rows (a pyarrow Table, a data frame, a dict of columns), found {kind}: {error}") from None


def count_of(reason, found):
    """How often something was left out for a reason."""
    try:
        count = int(found)
        if count == found and 0 <= count < 2**63:
            return count
    except (TypeError, ValueError, OverflowError):
        pass
    raise Refused(f"expected how often {str(reason)!r} was, a whole number from 0, found {found!r}")


def call(function, params, ports, tables):
    """The rows that the function makes, and what it says that it left out."""
    import pyarrow

    given = {port: pyarrow.ipc.open_stream(table).read_all() for port, table in zip(ports, tables)}
    found = function(**given, **params)
    skipped = {}
    if isinstance(found, tuple) and len(found) == 2 and isinstance(found[1], dict):
        found, skipped = found
    skipped = {str(reason): count_of(reason, count) for reason, count in skipped.items()}
    rows = table_of(found)
    sink = pyarrow.BufferOutputStream()
    with pyarrow.ipc.new_stream(sink, rows.schema) as writer:
        writer.write_table(rows)
    return {"skipped": skipped}, sink.getvalue()


def one_line(text):
    line = " ".join(part.strip() for part in text.splitlines() if part.strip())
    return line if len(line) <= LONGEST_ERROR else line[:LONGEST_ERROR] + "…"


def told(error):
    """An error in one line, with the line of the function's code that it comes from."""
    if isinstance(error, Refused):
        return one_line(str(error))
    trace = traceback.TracebackException.from_exception(error)
    trace.stack[:] = [frame for frame in trace.stack if frame.filename != HERE]
    print("".join(trace.format()), end="", file=sys.stderr, flush=True)
    if isinstance(error, SyntaxError):
        return one_line(f"{type(error).__name__}: {error}")
    what = one_line("".join(trace.format_exception_only()))
    last = next((frame for frame in reversed(trace.stack)), None)
    return f"{what} ({last.filename}, line {last.lineno}, in {last.name})" if last else what


def listen(stream, messages):
    """Reads ahead, so that the end of who asks ends this process, whatever it is doing."""
    try:
        while True:
            messages.put(read_message(stream))
    except (EOFError, OSError):
        os._exit(0)


def main():
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who asks is told, and ends this
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    asked, ends = os.getpid(), [requests.fileno(), answers.fileno()]

    def leave():
        while ends:
            os.close(ends.pop())

    os.register_at_fork(after_in_child=leave)  # who asks hears of this process alone, and when it ends
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)  # what a function prints is for the person who wrote it
    messages = queue.Queue(1)
    threading.Thread(target=listen, args=(requests, messages), daemon=True).start()
    function, request = None, {}
    while True:
        header, tables = messages.get()
        table = None
        try:
            if function is None:
                function, request = load(header), header
                answer = {"environment": environment()}
            else:
                answer, table = call(function, request["params"], header["tables"], tables)
        except BaseException as error:  # SystemExit too: an answer is owed
            answer = {"error": told(error)}
        if os.getpid() != asked:  # a child of the function has come back from it: nobody asked it
            sys.stdout.flush()
            os._exit("error" in answer)
        try:
            write_message(answers, {"number": header["number"], **answer}, table)
        except BrokenPipeError:
            return


main()
