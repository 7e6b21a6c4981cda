"""A page that is dragged without rest: thousands of changes on the socket, and the server's memory stays flat."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
import pytest
from helpers_studio import FILM, Server, memory_of
from websockets.sync.client import ClientConnection, connect

WARM, DRAGGED = 500, 1500
LAMPS = ("D65", "A", "F11")
FLAT = 1.05
WRONG = {"path": "layers[0].thickness_nm", "value": -3}


def conversation(server: Server) -> ClientConnection:
    here, token = f"127.0.0.1:{server.port}", server.address.partition("token=")[2]
    cookie = f"nacre_studio_{server.port}={token}"
    return connect(f"ws://{here}/ws", origin=f"http://{here}", additional_headers={"cookie": cookie})  # type: ignore[arg-type]


def change(random: np.random.Generator) -> list[dict[str, Any]]:
    """What a hand does: mostly one number, now and then a layer more, or a value that is not allowed."""
    kind = random.random()
    if kind < 0.03:
        return [WRONG]
    edits: list[dict[str, Any]] = [
        {"path": f"layers[{int(random.integers(2))}].thickness_nm", "value": float(random.uniform(10, 400))}
    ]
    if kind < 0.2:
        layer = {
            "material": ("MgF2", "TiO2", "Al2O3")[int(random.integers(3))],
            "thickness_nm": float(random.uniform(5, 90)),
        }
        edits.insert(0, {"op": "insert", "path": "layers", "index": int(random.integers(3)), "value": layer})
    return edits


def drag(socket: ClientConnection, random: np.random.Generator, first: int, count: int) -> int:
    """Ask so often, sometimes not waiting for the answer; return how many answers were mistakes that were asked for."""
    mistakes = 0
    for seq in range(first, first + count):
        edits = change(random)
        question = {"seq": seq, "name": "film.toml", "text": FILM, "edits": edits, "lamp": LAMPS[seq // 50 % 3]}
        socket.send(json.dumps(question))
        if seq % 5 == 0 and seq + 1 < first + count:
            continue  # the next one comes before this one is answered
        answer: dict[str, Any] = {"seq": -1}
        while answer["seq"] < seq:
            data = socket.recv()
            (length,) = struct.unpack_from("<I", data) if isinstance(data, bytes) else (0,)
            newer = json.loads(data[4 : 4 + length]) if isinstance(data, bytes) else json.loads(data)
            assert newer["seq"] > answer["seq"]
            answer = newer
        assert answer["seq"] == seq
        assert ("error" in answer) == (edits == [WRONG]), answer.get("error")
        mistakes += "error" in answer
    return mistakes


@pytest.mark.full
def test_memory_is_flat_while_a_page_is_dragged_without_rest(server: Server) -> None:
    random = np.random.default_rng(5)
    with conversation(server) as socket:
        drag(socket, random, 1, WARM)
        before = memory_of(server)
        mistakes = drag(socket, random, 1 + WARM, DRAGGED)
        after = memory_of(server)
    assert 0 < mistakes < 0.1 * DRAGGED
    assert after < FLAT * before
