"""Real transports for simulated instruments: TCP sockets and a pseudo terminal.

One asyncio loop in a thread of its own serves them all, so that a driver on
another thread talks to them as it would to hardware. Either transport serves
any device, and either has the faults of `drivers.simulated.faults`.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import threading
from collections.abc import AsyncIterator, Coroutine
from typing import Any, Protocol, TypeVar

from drivers.simulated.faults import Faults, spoil

_READ = 1 << 16
_BYTES_PER_SECOND = 11520  # 115200 baud, 8N1
_T = TypeVar("_T")


class Conversation(Protocol):
    """What one client says to a device, and what it answers."""

    def feed(self, data: bytes) -> AsyncIterator[tuple[bytes, bytes]]:
        """Every message that ``data`` completes, with its answer; empty: none."""
        ...


class Device(Protocol):
    """Anything that answers bytes with bytes."""

    faults: Faults

    def conversation(self) -> Conversation: ...


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
    """A device on a TCP port; any number of connections."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._server: asyncio.Server | None = None
        self._writers: set[asyncio.StreamWriter] = set()
        self._tasks: set[asyncio.Task[None]] = set()
        self.address = ""

    async def start(self, host: str, port: int) -> None:
        self._server = await asyncio.start_server(self._connected, host, port, limit=1 << 22)
        port = self._server.sockets[0].getsockname()[1]
        self.address = f"TCPIP::{host}::{port}::SOCKET"
        if self._device.faults.strike("refuse"):
            self._server.close()

    async def stop(self) -> None:
        # A connection that is being made takes some turns of the loop, and its socket would be
        # forgotten if the server were closed meanwhile.
        await asyncio.sleep(0.002)
        if self._server is not None:
            self._server.close()
        for writer in list(self._writers):
            writer.close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await asyncio.sleep(0)

    def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.add(writer)
        task = asyncio.get_running_loop().create_task(self._serve(reader, writer))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        conversation = self._device.conversation()
        try:
            if self._device.faults.strike("drop_at_once"):
                return
            while data := await reader.read(_READ):
                async for message, answer in conversation.feed(data):
                    if answer and not await self._answer(writer, message, answer):
                        return
        except (ConnectionError, asyncio.CancelledError):
            pass
        finally:
            self._writers.discard(writer)
            writer.close()
            with contextlib.suppress(ConnectionError, asyncio.CancelledError):
                await writer.wait_closed()

    async def _answer(self, writer: asyncio.StreamWriter, message: bytes, answer: bytes) -> bool:
        """Send an answer; False when the connection ends with it."""
        spoilt = spoil(self._device.faults, message, answer)
        for delay_s, piece in spoilt.pieces:
            if delay_s:
                await asyncio.sleep(delay_s)
            writer.write(piece)
            await writer.drain()
        return not spoilt.hang_up


class PtyServer:
    """A device on a pseudo terminal.

    The kernel enforces no baud rate; ``paced`` makes answers take the time that
    they would take on the line.
    """

    def __init__(self, device: Device, paced: bool) -> None:
        self._device = device
        self._conversation = device.conversation()
        self._paced = paced
        self._said: asyncio.Queue[bytes] = asyncio.Queue()
        self._near = self._far = -1
        self._talk: asyncio.Task[None] | None = None
        self.address = ""

    async def start(self, host: str, port: int) -> None:
        """Make the terminal; host and port mean nothing to it."""
        import tty

        self._near, self._far = os.openpty()
        tty.setraw(self._far)  # no echo, no translation of line ends
        os.set_blocking(self._near, False)
        # The far side stays open here as well: without any holder, reads fail with EIO.
        self.address = os.ttyname(self._far)
        asyncio.get_running_loop().add_reader(self._near, self._readable)
        self._talk = asyncio.create_task(self._answer_all())
        if self._device.faults.strike("refuse"):
            self._unplug()

    async def stop(self) -> None:
        self._unplug()
        if self._talk is not None:
            self._talk.cancel()
            await asyncio.gather(self._talk, return_exceptions=True)

    def _unplug(self) -> None:
        if self._near >= 0:
            asyncio.get_running_loop().remove_reader(self._near)
            os.close(self._near)
            os.close(self._far)
            self._near = self._far = -1

    def _readable(self) -> None:
        with contextlib.suppress(BlockingIOError, OSError):
            self._said.put_nowait(os.read(self._near, _READ))

    async def _answer_all(self) -> None:
        while self._near >= 0:
            data = await self._said.get()
            async for message, answer in self._conversation.feed(data):
                spoilt = spoil(self._device.faults, message, answer)
                for delay_s, piece in spoilt.pieces:
                    paced_s = len(piece) / _BYTES_PER_SECOND if self._paced else 0.0
                    await asyncio.sleep(delay_s + paced_s)
                    await self._send(piece)
                if spoilt.hang_up:
                    self._unplug()
                    return

    async def _send(self, left: bytes) -> None:
        while left:
            try:
                left = left[os.write(self._near, left) :]
            except BlockingIOError:  # the kernel's buffer is full until someone reads
                await asyncio.sleep(0.005)
            except OSError:  # unplugged
                return
