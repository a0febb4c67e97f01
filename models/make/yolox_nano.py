#!/usr/bin/env python3
"""Makes models/yolox_nano.onnx from the file that the authors of YOLOX published.

    pip install onnx==1.23.2
    python models/make/yolox_nano.py yolox_nano.onnx models/yolox_nano.onnx

The origin is `yolox_nano.onnx` of release 0.1.1rc0 of https://github.com/Megvii-BaseDetection/YOLOX. The same bytes lie
in https://github.com/Kazuhito00/YOLOX-ONNX-TFLite-Sample (model/yolox_nano.onnx).

The sides of the input, 416 by 416 in the original, are left open, and with them the number of answers. All layers are
convolutions, so that any multiples of 32 serve. Weights are stored as 16-bit floats, which halves the file.
"""

import hashlib
import sys
from pathlib import Path

import onnx
from half import with_half_weights

ORIGIN_SHA256 = "695e750a5d5754bb5a8d5325643b59282191a7e7a564e435a415fd3c578eab14"
RESULT_SHA256 = "1a3796521da0e5cf3aeb5a530503e3738929d606b1098eacc67445142366d163"


def check(data: bytes, expected: str, what: str) -> None:
    """Ends the script if bytes are not those that are expected."""
    found = hashlib.sha256(data).hexdigest()
    if found != expected:
        sys.exit(f"{what} has sha256 {found}, expected {expected}")


def with_open_sides(model: onnx.ModelProto) -> onnx.ModelProto:
    """Leaves height and width of the input open, the number of rows of the output, and all that follows from them."""
    graph = model.graph
    height, width = graph.input[0].type.tensor_type.shape.dim[2:]
    height.dim_param, width.dim_param = "height", "width"
    graph.output[0].type.tensor_type.shape.dim[1].dim_param = "count"
    del graph.value_info[:]
    onnx.checker.check_model(model, full_check=True)
    return model


def main() -> None:
    """Reads, changes, checks, writes."""
    if len(sys.argv) != 3:
        sys.exit(f"usage: {sys.argv[0]} ORIGIN.onnx RESULT.onnx")
    origin = Path(sys.argv[1]).read_bytes()
    check(origin, ORIGIN_SHA256, sys.argv[1])
    result = with_half_weights(with_open_sides(onnx.load_model_from_string(origin))).SerializeToString(
        deterministic=True
    )
    check(result, RESULT_SHA256, "the result (another version of onnx?)")
    Path(sys.argv[2]).write_bytes(result)


if __name__ == "__main__":
    main()
