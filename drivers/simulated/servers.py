"""Real transports for simulated instruments: TCP sockets and a pseudo terminal.

One asyncio loop in a thread of its own serves them all, so that a driver on
another thread talks to them as it would to hardware. Faults of the line are
made here: ``refuse`` (nothing listens), ``late_reply`` (seconds of real delay
before the next answer, once), ``hang_up`` (the connection is closed in the
middle of the next answer, once).
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import threading
from collections.abc import Coroutine
from typing import Any, Protocol, TypeVar

from drivers.scpi import ErrorEntry, MessageSplitter, ScpiSyntaxError
from drivers.simulated.scpi_device import ScpiDevice

_READ = 1 << 16
_BYTES_PER_SECOND = 11520  # 115200 baud, 8N1
_T = TypeVar("_T")


class SerialDevice(Protocol):
    """Anything that answers bytes with bytes."""

    def feed(self, data: bytes) -> bytes: ...


class LoopThread:
    """An asyncio loop in a daemon thread."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(
            target=self._loop.run_forever, name="simulated-bench", daemon=True
        )
        self._thread.start()

    def run(self, work: Coroutine[Any, Any, _T]) -> _T:
        """Run a coroutine on the loop and wait for what it returns."""
        return asyncio.run_coroutine_threadsafe(work, self._loop).result()

    def stop(self) -> None:
        self.run(self._cancel_all())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _cancel_all(self) -> None:
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)
        await asyncio.sleep(0)  # closed transports report to the loop once more


class TcpServer:
    """A SCPI instrument on a TCP port; any number of connections."""

    def __init__(self, device: ScpiDevice) -> None:
        self._device = device
        self._server: asyncio.Server | None = None
        self._writers: set[asyncio.StreamWriter] = set()
        self.port = 0

    async def start(self, host: str, port: int) -> None:
        self._server = await asyncio.start_server(self._serve, host, port, limit=1 << 22)
        self.port = self._server.sockets[0].getsockname()[1]
        if self._device.faults.get("refuse"):
            self._server.close()

    async def stop(self) -> None:
        if self._server is not None:
            self._server.close()
        for writer in list(self._writers):
            writer.close()
        await asyncio.sleep(0)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.add(writer)
        splitter = MessageSplitter()
        try:
            while data := await reader.read(_READ):
                try:
                    messages = splitter.feed(data)
                except ScpiSyntaxError as error:
                    self._device.report(ErrorEntry(error.code, error.text))
                    continue
                for message in messages:
                    answer = await self._device.execute(message)
                    if answer is not None and not await self._answer(writer, answer):
                        return
        except (ConnectionError, asyncio.CancelledError):
            pass
        finally:
            self._writers.discard(writer)
            writer.close()
            with contextlib.suppress(ConnectionError, asyncio.CancelledError):
                await writer.wait_closed()

    async def _answer(self, writer: asyncio.StreamWriter, answer: bytes) -> bool:
        faults: Any = self._device.faults
        if delay := faults.get("late_reply"):
            faults.pop("late_reply")
            await asyncio.sleep(delay)
        if faults.get("hang_up"):
            faults.pop("hang_up")
            writer.write(answer[: len(answer) // 2])
            return False
        writer.write(answer)
        await writer.drain()
        return True


class PtyServer:
    """A serial instrument on a pseudo terminal.

    The kernel enforces no baud rate; ``paced`` makes answers take the time that
    they would take on the line.
    """

    def __init__(self, device: SerialDevice, paced: bool) -> None:
        self._device = device
        self._paced = paced
        self._queue: asyncio.Queue[bytes] = asyncio.Queue()
        self.path = ""

    async def start(self) -> None:
        import tty

        self._near, self._far = os.openpty()
        tty.setraw(self._far)  # no echo, no translation of line ends
        os.set_blocking(self._near, False)
        # The far side stays open here as well: without any holder, reads fail with EIO.
        self.path = os.ttyname(self._far)
        asyncio.get_running_loop().add_reader(self._near, self._readable)
        self._writer = asyncio.create_task(self._write_answers())

    async def stop(self) -> None:
        asyncio.get_running_loop().remove_reader(self._near)
        self._writer.cancel()
        await asyncio.gather(self._writer, return_exceptions=True)
        os.close(self._near)
        os.close(self._far)

    def _readable(self) -> None:
        with contextlib.suppress(BlockingIOError, OSError):
            answer = self._device.feed(os.read(self._near, _READ))
            if answer:
                self._queue.put_nowait(answer)

    async def _write_answers(self) -> None:
        while True:
            left = await self._queue.get()
            if self._paced:
                await asyncio.sleep(len(left) / _BYTES_PER_SECOND)
            while left:
                try:
                    left = left[os.write(self._near, left) :]
                except BlockingIOError:  # the kernel's buffer is full until someone reads
                    await asyncio.sleep(0.005)
