"""The header of a safetensors file: metadata and the table of tensors, read and replaced without any tensor library.

The format (huggingface/safetensors, README): eight bytes with the length of the header, little-endian; the header, JSON
padded with spaces; the tensors' bytes.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from np_description.weights.released import WeightsError

_LENGTH = 8  # bytes
_METADATA = "__metadata__"


def read_metadata(path: str | Path) -> dict[str, str]:
    """The metadata of a safetensors file; {} where it has none. Reads no tensors.

    Raises WeightsError if the file is missing or is no safetensors file.
    """
    path = Path(path)
    if not path.is_file():
        raise WeightsError(f"weights: expected the file {path}, which does not exist; `make train` writes it")
    with path.open("rb") as file:
        length = int.from_bytes(file.read(_LENGTH), "little")
        if length > path.stat().st_size:
            raise WeightsError(f"weights: {path}: expected a safetensors file, got another or half of one")
        return _parse(file.read(length), path).get(_METADATA, {})


def with_metadata(content: bytes, metadata: dict[str, str]) -> bytes:
    """The bytes of a safetensors file with this metadata in place of its own; the tensors' bytes stay as they are.

    Equal metadata give equal bytes, which the library's own writer, whose order is random, does not.
    Raises WeightsError where `content` is no safetensors file.
    """
    table, data = _split(content)
    header = json.dumps({_METADATA: dict(sorted(metadata.items())), **table}, separators=(",", ":")).encode()
    header += b" " * (-len(header) % _LENGTH)
    return len(header).to_bytes(_LENGTH, "little") + header + data


def tensors_sha256(path: str | Path) -> str:
    """Hex digest of a file's tensors: names, shapes, types and bytes, without its metadata. Raises WeightsError."""
    table, data = _split(Path(path).read_bytes())
    return hashlib.sha256(json.dumps(table, sort_keys=True).encode() + data).hexdigest()


def _split(content: bytes) -> tuple[dict, bytes]:
    """The table of tensors and their bytes."""
    end = _LENGTH + int.from_bytes(content[:_LENGTH], "little")
    table = _parse(content[_LENGTH:end], "bytes of weights")
    table.pop(_METADATA, None)
    return table, content[end:]


def _parse(header: bytes, name: object) -> dict:
    try:
        return json.loads(header)
    except ValueError as error:
        raise WeightsError(f"weights: {name}: expected a safetensors file, got another or half of one") from error
