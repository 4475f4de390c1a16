"""Ends the prompt of `evermap sql` while it waits for a line, and while it answers: nothing of it stays.

    prompt.py PROGRAM LOG
"""

import fcntl
import os
import pty
import select
import signal
import struct
import subprocess
import sys
import tempfile
import termios
import time

# Its groups are more than `--memory`.
SPILLS = (
    "SELECT count(*) FROM (SELECT t, count(*) FROM (SELECT repeat('a', 1000) || value AS t"
    " FROM generate_series(1, 200000)) GROUP BY t);"
)
ENDLESS = "SELECT sum(value % 2) FROM generate_series(1, 9223372036854775807);"


class Prompt:
    """A prompt at a terminal, whose temporary files are in a folder."""

    def __init__(self, program, log, folder):
        self.temporary = os.path.join(folder, "temporary")
        os.mkdir(self.temporary)
        environment = os.environ | {"TMPDIR": self.temporary, "XDG_STATE_HOME": folder}
        self.person, self.terminal = pty.openpty()
        fcntl.ioctl(self.terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 120, 0, 0))
        self.settings = termios.tcgetattr(self.terminal)
        self.program = subprocess.Popen(
            [program, "sql", "--memory", "64MiB", "--sessions", log],
            stdin=self.terminal,
            stdout=self.terminal,
            stderr=self.terminal,
            env=environment,
            start_new_session=True,
            preexec_fn=self.own,
        )
        self.shown = b""

    @staticmethod
    def own():
        """The terminal is the program's own, so that it is told when that is gone, and hangups end it."""
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)
        signal.signal(signal.SIGHUP, signal.SIG_DFL)

    def look(self):
        """Reads what is shown, for a moment, and says where the cursor is, if that is asked."""
        if not select.select([self.person], [], [], 0.1)[0]:
            return
        try:
            shown = os.read(self.person, 1 << 16)
        except OSError:
            return  # The program has ended.
        self.shown += shown
        for _ in range(shown.count(b"\x1b[6n")):
            os.write(self.person, b"\x1b[1;1R")

    def until(self, what, seconds=120):
        end = time.monotonic() + seconds
        while not what():
            assert time.monotonic() < end, self.shown
            self.look()

    def type(self, text):
        os.write(self.person, text.encode() + b"\r")

    def waits(self):
        """Waits until it reads a line."""
        self.until(lambda: not self.is_cooked())
        for _ in range(5):
            self.look()

    def is_cooked(self):
        return bool(termios.tcgetattr(self.terminal)[3] & termios.ICANON)

    def ended(self):
        """Waits until it has ended, as it does when it is stopped, and has left nothing."""
        self.until(lambda: self.program.poll() is not None, 20)
        assert self.program.returncode == 1, (self.program.returncode, self.shown)

    def left(self):
        return os.listdir(self.temporary)


def spilled(prompt):
    """Has it put something on the disk, and wait for the next line."""
    prompt.waits()
    prompt.type(SPILLS)
    prompt.until(lambda: b"1 row, " in prompt.shown)
    assert prompt.left(), "it had room in memory"
    prompt.waits()


def told(program, log, number):
    with tempfile.TemporaryDirectory() as folder:
        prompt = Prompt(program, log, folder)
        spilled(prompt)
        prompt.program.send_signal(number)
        prompt.ended()
        assert prompt.left() == [], prompt.left()
        assert termios.tcgetattr(prompt.terminal)[:4] == prompt.settings[:4]


def hung_up(program, log):
    """By the system, as the terminal is gone: the editor gets nothing but errors."""
    with tempfile.TemporaryDirectory() as folder:
        prompt = Prompt(program, log, folder)
        spilled(prompt)
        os.close(prompt.terminal)
        os.close(prompt.person)
        assert prompt.program.wait(20) == 1
        assert prompt.left() == [], prompt.left()


def told_while_it_answers(program, log):
    with tempfile.TemporaryDirectory() as folder:
        prompt = Prompt(program, log, folder)
        spilled(prompt)
        prompt.type(ENDLESS)
        prompt.until(prompt.is_cooked)
        time.sleep(1)
        assert prompt.program.poll() is None, prompt.shown
        prompt.program.send_signal(signal.SIGTERM)
        prompt.ended()
        assert b"stopped" in prompt.shown, prompt.shown


if __name__ == "__main__":
    _, program, log = sys.argv
    for number in (signal.SIGHUP, signal.SIGTERM):
        told(program, log, number)
    hung_up(program, log)
    told_while_it_answers(program, log)
