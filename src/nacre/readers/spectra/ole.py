"""Streams of an OLE file (compound file binary, Microsoft [MS-CFB]), as older programs of instruments write them."""

from __future__ import annotations

import struct

OLE_MAGIC = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
_LAST_SECTOR = 0xFFFFFFFA  # larger numbers end a chain
_MINI_LIMIT = 4096


class OleFile:
    """The streams of a compound file.

    Raises:
        ValueError: the file is damaged.
    """

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._size = 1 << struct.unpack_from("<H", data, 30)[0]
        self._mini_size = 1 << struct.unpack_from("<H", data, 32)[0]
        if not (64 <= self._size <= 1 << 16 and 8 <= self._mini_size <= self._size):
            raise ValueError("sizes of sectors")
        fat_sectors = [sector for sector in struct.unpack_from("<109I", data, 76) if sector < _LAST_SECTOR]
        directory, _, _, mini_fat, _, more, _ = struct.unpack_from("<7I", data, 48)
        while more < _LAST_SECTOR:
            block = struct.unpack(f"<{self._size // 4}I", self._sector(more))
            fat_sectors += [sector for sector in block[:-1] if sector < _LAST_SECTOR]
            more = block[-1]
        self._fat = [
            entry for sector in fat_sectors for entry in struct.unpack(f"<{self._size // 4}I", self._sector(sector))
        ]
        mini = self._chain(mini_fat, self._fat, self._sector)
        self._mini_fat = list(struct.unpack(f"<{len(mini) // 4}I", mini))
        self._entries: dict[str, tuple[int, int]] = {}
        root = b""
        entries = self._chain(directory, self._fat, self._sector)
        for at in range(0, len(entries) - 127, 128):
            entry = entries[at : at + 128]
            length, kind = struct.unpack_from("<HB", entry, 64)
            first, size = struct.unpack_from("<II", entry, 116)
            if kind == 5:
                root = self._chain(first, self._fat, self._sector)
            elif kind == 2:
                self._entries[entry[: max(0, length - 2)].decode("utf-16-le", errors="replace")] = (first, size)
        self._mini_stream = root

    @property
    def names(self) -> list[str]:
        """Names of all streams, without their storages."""
        return list(self._entries)

    def stream(self, name: str) -> bytes:
        """Return a stream's content.

        Raises:
            KeyError: there is none of this name.
        """
        first, size = self._entries[name]
        if size < _MINI_LIMIT:
            return self._chain(first, self._mini_fat, self._mini_sector)[:size]
        return self._chain(first, self._fat, self._sector)[:size]

    def _sector(self, number: int) -> bytes:
        found = self._data[(number + 1) * self._size : (number + 2) * self._size]
        return found.ljust(self._size, b"\0")

    def _mini_sector(self, number: int) -> bytes:
        return self._mini_stream[number * self._mini_size : (number + 1) * self._mini_size]

    def _chain(self, first: int, table: list[int], sector: object) -> bytes:
        parts: list[bytes] = []
        number = first
        while number < _LAST_SECTOR:
            if number >= len(table) or len(parts) > len(table):
                raise ValueError("a chain of sectors")
            parts.append(sector(number))  # type: ignore[operator]
            number = table[number]
        return b"".join(parts)
