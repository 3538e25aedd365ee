"""Three engines with one interface: this process, worker processes, a Dask cluster. Each yields
chunks as they finish, in any order.

None holds more than a few chunks at a time: a new chunk is submitted when a result arrives.
"""

from __future__ import annotations

import re
import sys
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from queue import SimpleQueue

from hiltestbed.campaign.cases import ChunkResult, run_chunk
from hiltestbed.campaign.schema import LoadedCampaign
from hiltestbed.errors import HiltestbedError, InputError, MissingExtra
from hiltestbed.process.workers import Workers

Chunk = Sequence[int]
Results = Generator[ChunkResult, None, None]
Engine = Callable[[LoadedCampaign, Iterable[Chunk]], Results]

ATTEMPTS = 4  # of a chunk whose worker dies; after these the chunk is assumed to be the cause
ANSWER = 5.0  # [s] timeout for the scheduler's answer


def serial(campaign: LoadedCampaign, chunks: Iterable[Chunk]) -> Results:
    """Every chunk in this process."""
    for chunk in chunks:
        yield run_chunk(campaign, chunk)


def processes(workers: int, campaign: LoadedCampaign, chunks: Iterable[Chunk]) -> Results:
    """By `workers` processes on this machine."""
    attempts: Counter[Chunk] = Counter()
    waiting = iter(chunks)
    again: list[Chunk] = []
    while True:
        lost = yield from _until_broken(campaign, waiting, again, workers)
        if not lost:
            return
        attempts.update(lost)
        for chunk in lost:
            if attempts[chunk] >= ATTEMPTS:
                raise HiltestbedError(
                    f"cases {min(chunk)} to {max(chunk)}: the worker process died {ATTEMPTS} times "
                    f"(killed, or out of memory); the same command resumes where it stopped, with "
                    f"fewer --workers or a smaller --chunk"
                )
        again = list(lost)


def _until_broken(
    campaign: LoadedCampaign, waiting: Iterator[Chunk], again: list[Chunk], workers: int
):
    """Yields results until all is done or a worker dies; returns the chunks in progress then."""
    pool = Workers(workers)
    running: dict[Future[ChunkResult], Chunk] = {}
    ended: SimpleQueue[Future[ChunkResult]] = SimpleQueue()  # a Ctrl-C ends the wait for it at once
    next_up = list(again)
    try:
        while True:
            next_up += islice(waiting, max(0, 2 * workers - len(running) - len(next_up)))
            while next_up:
                future = pool.submit(run_chunk, campaign, next_up[0])
                running[future] = next_up.pop(0)
                future.add_done_callback(ended.put)
            if not running:
                return ()
            future = ended.get()
            result = future.result()
            del running[future]
            yield result
    except BrokenProcessPool:
        return (*running.values(), *next_up)
    finally:
        pool.shutdown(cancel_futures=True)


def dask(address: str) -> Engine:
    """The engine of a Dask cluster whose scheduler is at `address` (`tcp://host:8786`, `tls://...`
    with Dask's own TLS settings).

    Raises InputError if the scheduler does not answer.
    """
    client = _connect(address)

    def engine(campaign: LoadedCampaign, chunks: Iterable[Chunk]) -> Results:
        try:
            yield from _on_cluster(client, campaign, iter(chunks))
        finally:
            client.close(timeout=2)

    return engine


def _connect(address: str):
    if not re.fullmatch(
        r"((tcp|tls|ws|wss|ucx)://)?(\[[0-9a-fA-F:]+\]|[^\s:/\[\]]+):\d{1,5}", address
    ):
        raise InputError(
            f"--scheduler {address}: is no address of a scheduler; write it as tcp://HOST:8786 or "
            f"tls://HOST:8786"
        )
    try:
        from distributed import Client
        from distributed.security import Security
    except ImportError:
        raise MissingExtra("--scheduler", "cluster") from None
    certified = Security().get_connection_args("client").get("ssl_context") is not None
    if address.startswith("tls://") and not certified:
        raise InputError(
            f"--scheduler {address}: TLS has no certificates; give them to Dask, as "
            f"DASK_DISTRIBUTED__COMM__TLS__CA_FILE, "
            "..._TLS__CLIENT__CERT and ..._TLS__CLIENT__KEY in the environment"
        )
    try:
        return Client(address, timeout=ANSWER, set_as_default=False)
    except (OSError, TimeoutError, ValueError, TypeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            f"--scheduler {address}: does not answer within {ANSWER:.0f} s ({reason}); start one "
            f"with `dask scheduler` and give its address"
        ) from None


def _on_cluster(
    client, campaign: LoadedCampaign, waiting: Iterator[Chunk]
) -> Iterator[ChunkResult]:
    from concurrent.futures import CancelledError

    from distributed import KilledWorker, as_completed

    from hiltestbed.run_folder.versions import provenance

    warned = False
    running = as_completed(loop=client.loop)
    while True:
        threads = sum(client.nthreads().values())
        if not threads and not warned:
            sys.stderr.write(
                "the scheduler has no workers yet; waiting for them (start some with `dask worker "
                "ADDRESS --nthreads 1`)\n"
            )
            warned = True
        for chunk in islice(waiting, max(0, 2 * max(threads, 1) - running.count())):
            running.add(
                client.submit(run_chunk_of, campaign, tuple(chunk), provenance(), pure=False)
            )
        if running.is_empty():
            return
        try:
            yield next(running).result()
        except KilledWorker as error:
            raise HiltestbedError(
                f"a chunk has killed every worker that took it ({error}); the same command tries "
                f"again"
            ) from None
        except CancelledError:
            raise HiltestbedError(
                "the scheduler was lost; the same command resumes where it stopped"
            ) from None


def run_chunk_of(campaign: LoadedCampaign, chunk: Chunk, expected: dict[str, str]) -> ChunkResult:
    """`run_chunk` on a remote worker, which must have the campaign's package versions and code."""
    from hiltestbed.run_folder.versions import differences

    if differ := differences(expected):
        raise HiltestbedError(
            f"a worker has other versions or other code, whose numbers may differ: {differ}; "
            f"install the same on every worker, and restart it"
        )
    return run_chunk(campaign, chunk)
