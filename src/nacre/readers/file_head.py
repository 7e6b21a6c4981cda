"""The beginning of a file, from which its format is recognised."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

# images, documents and archives whose first bytes may be printable
PRINTABLE_MAGIC = (b"\x89PNG", b"GIF8", b"%PDF", b"PK\x03\x04", b"\xff\xd8\xff", b"Rar!", b"7z\xbc\xaf", b"{\\rtf")
UTF_16_SHARE = 0.3  # of one parity of bytes, NUL: UTF-16 without a mark


def utf_16_order(data: bytes) -> str | None:
    """Return "utf-16-le" or "utf-16-be" for UTF-16 without a byte order mark, or None."""
    sample = data[:4000]
    if len(sample) < 4 or b"\0" not in sample:
        return None
    even, odd = (sample[i::2].count(0) / max(1, len(sample[i::2])) for i in (0, 1))
    text = sample.replace(b"\0", b"")
    if sum(byte < 9 or 13 < byte < 32 for byte in text) > 0.02 * len(text):
        return None
    if odd > UTF_16_SHARE and even < 0.1 * odd:
        return "utf-16-le"
    return "utf-16-be" if even > UTF_16_SHARE and odd < 0.1 * even else None


@dataclass(frozen=True)
class FileHead:
    """The beginning of a file, from which a format is recognised."""

    path: Path
    data: bytes
    size: int

    @cached_property
    def text(self) -> str:
        """Text of the head; UTF-16 is decoded, other bytes that are no UTF-8 become U+FFFD."""
        encoding = "utf-16" if self.data[:2] in (b"\xff\xfe", b"\xfe\xff") else utf_16_order(self.data) or "utf-8-sig"
        return self.data.decode(encoding, errors="replace")

    @cached_property
    def lines(self) -> list[str]:
        """Lines of the text."""
        return self.text.splitlines()

    @cached_property
    def is_text(self) -> bool:
        """Whether the head is text: few control characters."""
        if self.data[:2] in (b"\xff\xfe", b"\xfe\xff") or utf_16_order(self.data) is not None:
            return True
        sample = self.data[:4096]
        if sample.startswith(PRINTABLE_MAGIC):
            return False
        controls = sum(byte < 9 or 13 < byte < 32 for byte in sample.replace(b"\0", b""))
        return sample.count(0) <= 0.1 * len(sample) and controls <= 0.02 * len(sample)
