"""Networks in ONNX format, written by hand: the few fields of its protocol buffers that a declaration needs."""

from __future__ import annotations


def _varint(value: int) -> bytes:
    parts = []
    while True:
        value, low = value >> 7, value & 127
        parts.append(low | (128 if value else 0))
        if not value:
            return bytes(parts)


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _bytes(field: int, content: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(content)) + content


def _tensor(name: str, shape: list[int]) -> bytes:
    """A ValueInfoProto of 32-bit floats."""
    dimensions = b"".join(_bytes(1, _number(1, side)) for side in shape)
    return _bytes(1, name.encode()) + _bytes(2, _bytes(1, _number(1, 1) + _bytes(2, dimensions)))


def _constant(name: str, values: list[int]) -> bytes:
    """A TensorProto of 64-bit integers."""
    content = _number(1, len(values)) + _number(2, 7) + _bytes(8, name.encode())
    return content + b"".join(_number(7, value) for value in values)


def _node(operator: str, inputs: list[str], output: str) -> bytes:
    names = b"".join(_bytes(1, name.encode()) for name in inputs)
    return names + _bytes(2, output.encode()) + _bytes(4, operator.encode())


def _model(graph: bytes) -> bytes:
    return _number(1, 8) + _bytes(7, graph) + _bytes(8, _number(2, 13))


def yolo(side: int) -> bytes:
    """A network with the layout of YOLO-seg for square pictures of `side`, whose answers are empty of meaning."""
    boxes, prototypes = [1, 116, 200], [1, 32, 8, 8]
    nodes = [
        _node("ReduceMean", ["images"], "mean"),
        _node("Squeeze", ["mean", "axis"], "flat"),
        _node("Expand", ["flat", "boxes"], "output0"),
        _node("Expand", ["mean", "prototypes"], "output1"),
    ]
    graph = b"".join(_bytes(1, node) for node in nodes)
    graph += _bytes(2, b"graph")
    graph += b"".join(
        _bytes(5, _constant(name, values))
        for name, values in [("boxes", boxes), ("prototypes", prototypes), ("axis", [3])]
    )
    graph += _bytes(11, _tensor("images", [1, 3, side, side]))
    graph += _bytes(12, _tensor("output0", boxes)) + _bytes(12, _tensor("output1", prototypes))
    return _model(graph)
