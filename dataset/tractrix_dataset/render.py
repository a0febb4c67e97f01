"""Rendering with Cycles: settings, one frame with its labels, devices."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from . import labels
from .scene import World, pose_frame

DEVICE_KINDS = ("OPTIX", "CUDA", "HIP", "ONEAPI", "METAL")


@dataclass(frozen=True)
class RenderOptions:
    """Image size in pixels, samples per pixel, threads (0 = all)."""

    width: int = 960
    height: int = 540
    samples: int = 4
    threads: int = 0


def use_gpu() -> str:
    """Turns on the first kind of GPU that Cycles finds; returns its name or ``CPU``."""
    preferences = bpy.context.preferences.addons["cycles"].preferences
    for kind in DEVICE_KINDS:
        try:
            preferences.compute_device_type = kind
        except TypeError:
            continue
        preferences.get_devices()
        found = [d for d in preferences.devices if d.type == kind]
        for device in found:
            device.use = True
        if found:
            bpy.context.scene.cycles.device = "GPU"
            return kind
    return "CPU"


def set_up(world: World, options: RenderOptions, scratch: Path) -> str:
    """Camera, Cycles and the index pass; returns the device used."""
    scene = bpy.context.scene
    lens = bpy.data.cameras.new("camera")
    lens.sensor_width, lens.sensor_fit = 36.0, "HORIZONTAL"
    lens.lens = 36.0 * world.camera.intrinsics(options.width, options.height)[0, 0] / options.width
    lens.clip_start, lens.clip_end = 0.1, 3000.0
    scene.camera = bpy.data.objects.new("camera", lens)
    scene.collection.objects.link(scene.camera)
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = (
        options.width,
        options.height,
        100,
    )
    scene.render.use_persistent_data = True
    if options.threads:
        scene.render.threads_mode, scene.render.threads = "FIXED", options.threads
    scene.view_settings.view_transform = "Standard"
    scene.render.image_settings.file_format, scene.render.image_settings.color_mode = "PNG", "RGB"
    scene.render.image_settings.compression = 15
    _cycles(scene.cycles, options)
    _index_pass(scene, scratch)
    return use_gpu()


def _cycles(cycles: object, options: RenderOptions) -> None:
    """Few samples, denoised with the help of albedo and normals."""
    cycles.samples = options.samples
    cycles.use_adaptive_sampling = False
    cycles.use_denoising, cycles.denoiser = True, "OPENIMAGEDENOISE"
    cycles.denoising_input_passes = "RGB_ALBEDO_NORMAL"
    cycles.denoising_prefilter, cycles.denoising_quality = "FAST", "BALANCED"
    cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 2, 1, 2
    cycles.transmission_bounces, cycles.transparent_max_bounces = 1, 2
    cycles.caustics_reflective = cycles.caustics_refractive = False
    cycles.use_light_tree = False
    cycles.sample_clamp_indirect, cycles.sample_clamp_direct = 4.0, 12.0


def _index_pass(scene: bpy.types.Scene, scratch: Path) -> None:
    """Writes the object index of every pixel beside each frame, as EXR."""
    bpy.context.view_layer.use_pass_object_index = True
    scene.use_nodes = True
    tree = scene.node_tree
    tree.nodes.clear()
    layers = tree.nodes.new("CompositorNodeRLayers")
    composite = tree.nodes.new("CompositorNodeComposite")
    tree.links.new(layers.outputs["Image"], composite.inputs["Image"])
    output = tree.nodes.new("CompositorNodeOutputFile")
    output.base_path = str(scratch)
    output.format.file_format, output.format.color_depth, output.format.color_mode = "OPEN_EXR", "32", "RGB"
    output.file_slots[0].path = "index_"
    tree.links.new(layers.outputs["IndexOB"], output.inputs[0])


@contextmanager
def _silence() -> Iterator[None]:
    """Sends what Blender prints about its progress to nowhere."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def render_frame(world: World, index: int, image: Path, semantic: Path, scratch: Path) -> None:
    """Renders one frame: a PNG and its semantic map, each whole or absent."""
    scene = bpy.context.scene
    pose_frame(world, index)
    scene.frame_set(index)
    scene.cycles.seed = index
    partial = image.with_suffix(".partial.png")
    scene.render.filepath = str(partial)
    with _silence():
        bpy.ops.render.render(write_still=True)
    pass_file = scratch / f"index_{index:04d}.exr"
    labels.write_png(semantic, labels.tidy(labels.read_index_pass(pass_file)))
    pass_file.unlink()
    partial.replace(image)


def projected(points: np.ndarray, world_from_camera: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Pixels (N, 2) of world points (N, 3)."""
    inside = (points - world_from_camera[:3, 3]) @ world_from_camera[:3, :3]
    image = inside @ k.T
    return image[:, :2] / image[:, 2:]
