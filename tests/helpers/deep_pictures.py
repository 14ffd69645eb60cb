"""Pictures of 16 bits that no library here writes."""

import struct
import zlib


def deep_png(path, array, gamma=None):
    """16-bit RGB PNG by hand: Pillow writes none."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows, columns, _ = array.shape
    raw = b"".join(b"\0" + row.astype(">u2").tobytes() for row in array)
    extra = b"" if gamma is None else chunk(b"gAMA", struct.pack(">I", round(gamma * 100000)))
    head = struct.pack(">IIBBBBB", columns, rows, 16, 2, 0, 0, 0)
    data = chunk(b"IHDR", head) + extra + chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + data)
