"""The guard as a process: ``python -m piezo_rig.guard SOCKET PIPE ORDERS``; the runner starts it.

It has a session of its own and is deaf to Ctrl-C, SIGTERM and a closed terminal: its end is the
runner's word, or rest.
"""

from __future__ import annotations

import signal
import socket
import sys


def main() -> int:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    from piezo_rig.guard.orders import Orders
    from piezo_rig.guard.watch import Watch

    runner, beats, orders = sys.argv[1:]
    watch = Watch(socket.socket(fileno=int(runner)), int(beats), Orders.from_json(orders))
    report = watch.keep()
    return 0 if report is None or report.at_rest else 4


if __name__ == "__main__":
    sys.exit(main())
