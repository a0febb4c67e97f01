"""A thin layer over Blender's shader nodes: sockets in, sockets out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy

Socket = Any
Value = Any


class Nodes:
    """Builds the node tree of one material; every method returns an output socket.

    ``flat`` textures depend on x and y alone: enough for the ground, and a
    third of the cost.
    """

    def __init__(self, material: bpy.types.Material | bpy.types.World, flat: bool = False) -> None:
        self.dimensions = "2D" if flat else "3D"
        material.use_nodes = True
        self.tree = material.node_tree
        self.tree.nodes.clear()

    def _set(self, socket: Socket, value: Value) -> None:
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, socket)
        elif isinstance(value, (tuple, list)) and len(value) == 3 and socket.type == "RGBA":
            socket.default_value = (*value, 1.0)
        else:
            socket.default_value = value

    def node(self, kind: str, inputs: dict | None = None, **settings: Value) -> bpy.types.Node:
        """A node of the given kind, with settings and inputs (by name or number)."""
        made = self.tree.nodes.new(kind)
        for name, value in settings.items():
            setattr(made, name, value)
        for name, value in (inputs or {}).items():
            if value is not None:
                self._set(made.inputs[name], value)
        return made

    def math(self, operation: str, a: Value, b: Value = None, clamp: bool = False) -> Socket:
        """A scalar operation (Blender's names: ADD, MULTIPLY, GREATER_THAN, ...)."""
        return self.node("ShaderNodeMath", {0: a, 1: b}, operation=operation, use_clamp=clamp).outputs[0]

    def step(self, value: Value, low: float, high: float) -> Socket:
        """Smooth step from 0 at ``low`` to 1 at ``high`` (either order)."""
        names = {"Value": value, "From Min": low, "From Max": high}
        return self.node("ShaderNodeMapRange", names, interpolation_type="SMOOTHSTEP").outputs[0]

    def mix(self, a: Value, b: Value, factor: Value, blend: str = "MIX") -> Socket:
        """A blend of two colours."""
        made = self.node("ShaderNodeMix", data_type="RGBA", blend_type=blend)
        for name, value in (("Factor_Float", factor), ("A_Color", a), ("B_Color", b)):
            self._set(next(s for s in made.inputs if s.identifier == name), value)
        return next(s for s in made.outputs if s.identifier == "Result_Color")

    def lerp(self, a: Value, b: Value, factor: Value) -> Socket:
        """A blend of two numbers."""
        return self.node("ShaderNodeMix", {2: a, 3: b, 0: factor}, data_type="FLOAT").outputs[0]

    def noise(self, at: Socket, per_m: float, detail: float = 3.0, roughness: float = 0.55) -> Socket:
        """Perlin noise about 0.5; ``per_m`` features per metre."""
        names = {"Vector": at, "Scale": per_m, "Detail": detail, "Roughness": roughness}
        return self.node("ShaderNodeTexNoise", names, noise_dimensions=self.dimensions).outputs[0]

    def voronoi(self, at: Socket, per_m: float, feature: str = "F1") -> bpy.types.Node:
        """A Voronoi texture node."""
        names = {"Vector": at, "Scale": per_m}
        return self.node("ShaderNodeTexVoronoi", names, feature=feature, voronoi_dimensions=self.dimensions)

    def position(self, kind: str = "Object") -> Socket:
        """Coordinates of the shaded point (metres, object space, or ``Normal``, ``UV``)."""
        return self.node("ShaderNodeTexCoord").outputs[kind]

    def attribute(self, name: str) -> Socket:
        """A scalar attribute of the mesh."""
        return self.node("ShaderNodeAttribute", attribute_name=name).outputs["Fac"]

    def random(self) -> Socket:
        """A number in [0, 1] of each object."""
        return self.node("ShaderNodeObjectInfo").outputs["Random"]

    def separate(self, vector: Socket) -> list[Socket]:
        """x, y, z of a vector."""
        return list(self.node("ShaderNodeSeparateXYZ", {0: vector}).outputs)

    def combine(self, x: Value, y: Value, z: Value = 0.0) -> Socket:
        """A vector from numbers."""
        return self.node("ShaderNodeCombineXYZ", {0: x, 1: y, 2: z}).outputs[0]

    def warp(self, at: Socket, per_m: float, amount_m: float) -> Socket:
        """Coordinates pushed about by noise, so that nothing runs straight."""
        names = {"Vector": at, "Scale": per_m, "Detail": 1.0}
        push = self.node("ShaderNodeTexNoise", names, noise_dimensions=self.dimensions).outputs[1]
        centered = self.node("ShaderNodeVectorMath", {0: push, 1: (0.5, 0.5, 0.5)}, operation="SUBTRACT").outputs[0]
        scaled = self.node("ShaderNodeVectorMath", {0: centered, "Scale": amount_m}, operation="SCALE").outputs[0]
        return self.node("ShaderNodeVectorMath", {0: at, 1: scaled}, operation="ADD").outputs[0]

    def ramp(self, value: Socket, stops: list[tuple[float, tuple[float, float, float]]]) -> Socket:
        """Colours at positions, linear between."""
        made = self.node("ShaderNodeValToRGB", {0: value})
        elements = made.color_ramp.elements
        while len(elements) < len(stops):
            elements.new(0.5)
        for element, (at, color) in zip(elements, stops):
            element.position, element.color = at, (*color, 1.0)
        return made.outputs[0]

    def surface(
        self,
        color: Value,
        roughness: Value = 0.9,
        metallic: Value = 0.0,
        coat: Value = 0.0,
        specular: Value = 0.3,
        distant: tuple[float, float, float] = (0.2, 0.2, 0.19),
    ) -> None:
        """Ends the tree with a principled surface.

        Only rays from the camera see the texture. Scattered and mirrored rays
        see the plain colour ``distant``, which costs nothing.
        """
        names = {
            "Base Color": color,
            "Roughness": roughness,
            "Metallic": metallic,
            "Coat Weight": coat,
            "Specular IOR Level": specular,
        }
        full = self.node("ShaderNodeBsdfPrincipled", names)
        full.inputs["Coat Roughness"].default_value = 0.04
        plain = self.node("ShaderNodeBsdfDiffuse", {"Color": distant})
        seen = self.node("ShaderNodeLightPath").outputs["Is Camera Ray"]
        mixed = self.node("ShaderNodeMixShader", {0: seen, 1: plain.outputs[0], 2: full.outputs[0]})
        self.node("ShaderNodeOutputMaterial", {"Surface": mixed.outputs[0]})


def material(name: str, build: Callable[[Nodes], None], flat: bool = False) -> bpy.types.Material:
    """The material of that name, built when it is first asked for."""
    found = bpy.data.materials.get(name)
    if found is None:
        found = bpy.data.materials.new(name)
        build(Nodes(found, flat))
    return found
