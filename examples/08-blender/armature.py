#!/usr/bin/env python3
"""Bends a model of any size by an armature in Blender: armature.py MODEL OUT

Needs Python 3.11 with the module bpy (pip install bpy==5.0.1), and the program simod on the path.
"""

import importlib.util
import math
import sys
from pathlib import Path

import bpy

EXTENSION = Path(__file__).resolve().parents[2] / "host" / "blender" / "__init__.py"


def extension():
    """The extension as it lies in the repository; a Blender with a window has it installed."""
    where = {"submodule_search_locations": [str(EXTENSION.parent)]}
    spec = importlib.util.spec_from_file_location("simod_blender", EXTENSION, **where)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    module.register()


def rig(low, high):
    """Two bones, one above the other along y."""
    rig = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    bpy.context.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    for name, start, end in (("lower", low, (low + high) / 2), ("upper", (low + high) / 2, high)):
        bone = rig.data.edit_bones.new(name)
        bone.head, bone.tail = (0, start, 0), (0, end, 0)
    bpy.ops.object.mode_set(mode="OBJECT")
    return rig


def main(model, out):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    extension()
    bpy.ops.simod.import_samples(filepath=model, preset="100000", wait=True)
    samples = bpy.context.object

    heights = [v.co.y for v in samples.data.vertices]
    low, high = min(heights), max(heights)
    groups = {name: samples.vertex_groups.new(name=name) for name in ("lower", "upper")}
    for i, height in enumerate(heights):
        t = min(1, max(0, 2 * (height - low) / (high - low) - 0.5))
        upper = t * t * (3 - 2 * t)
        groups["lower"].add([i], 1 - upper, "REPLACE")
        groups["upper"].add([i], upper, "REPLACE")

    bones = rig(low, high)
    samples.modifiers.new("Armature", "ARMATURE").object = bones
    bone = bones.pose.bones["upper"]
    bone.rotation_mode = "XYZ"
    bone.rotation_euler = (0, 0, math.radians(35))
    bpy.context.view_layer.objects.active = samples
    bpy.context.view_layer.update()
    bpy.ops.simod.write_model(filepath=out, wait=True)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
