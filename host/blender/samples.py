# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples as a mesh, and where Blender takes them."""

from pathlib import Path

import bmesh
import bpy
import numpy as np
from mathutils import Vector, kdtree

from .files import Sampled, read_ply

ID = "simod_id"
"""The attribute that holds the order of the samples."""
FOLDER = "simod_folder"
"""The property of an object with the folder of its sampled model."""


class Refused(Exception):
    """What was made of the samples cannot be written."""


def is_sampled(object: bpy.types.Object | None) -> bool:
    """Whether an object is of samples."""
    return object is not None and object.type == "MESH" and FOLDER in object


def sampled_of(object: bpy.types.Object) -> Sampled:
    """The sampled model of an object."""
    return Sampled.load(Path(object[FOLDER]))


def new_object(context: bpy.types.Context, sampled: Sampled) -> bpy.types.Object:
    """The samples as an object of the scene, which becomes the active one."""
    name = sampled.model.stem
    mesh = bpy.data.meshes.new(name)
    fill(mesh, sampled)
    object = bpy.data.objects.new(name, mesh)
    object[FOLDER] = str(sampled.folder)
    context.collection.objects.link(object)
    for other in context.view_layer.objects:
        other.select_set(False)
    object.select_set(True)
    context.view_layer.objects.active = object
    return object


def fill(mesh: bpy.types.Mesh, sampled: Sampled) -> None:
    """Makes an empty mesh one of the samples at rest."""
    count, triangles = len(sampled.positions), sampled.triangles
    mesh.vertices.add(count)
    mesh.vertices.foreach_set("co", sampled.local.ravel())
    if len(triangles):
        mesh.loops.add(triangles.size)
        mesh.loops.foreach_set("vertex_index", triangles.ravel())
        mesh.polygons.add(len(triangles))
        mesh.polygons.foreach_set("loop_start", np.arange(0, triangles.size, 3, dtype=np.int32))
    mesh.update(calc_edges=True)
    ids = mesh.attributes.new(ID, "INT", "POINT")
    ids.data.foreach_set("value", np.arange(count, dtype=np.int32))
    if sampled.colors is not None:
        colors = np.full((count, 4), 255, np.uint8)
        colors[:, :3] = sampled.colors
        layer = mesh.color_attributes.new("Color", "BYTE_COLOR", "POINT")
        layer.data.foreach_set("color_srgb", (colors / np.float32(255)).astype(np.float32).ravel())


def coordinates(mesh: bpy.types.Mesh, count: int) -> np.ndarray | None:
    """Where each sample is in a mesh, in its order: (N, 3), float64; None if one is gone or there twice."""
    ids = mesh.attributes.get(ID)
    if len(mesh.vertices) != count or ids is None or ids.domain != "POINT" or ids.data_type != "INT":
        return None
    order, found = np.empty(count, np.int32), np.empty(3 * count, np.float32)
    ids.data.foreach_get("value", order)
    mesh.vertices.foreach_get("co", found)
    if not np.array_equal(np.sort(order), np.arange(count)):
        return None
    ordered = np.empty((count, 3))
    ordered[order] = found.reshape(-1, 3)
    return ordered


def evaluated(context: bpy.types.Context, object: bpy.types.Object, sampled: Sampled) -> np.ndarray:
    """Where Blender takes the samples now: (N, 3), float64, model coordinates."""
    if object.mode == "EDIT":
        object.update_from_editmode()
    count = len(sampled.positions)
    if coordinates(object.data, count) is None:
        raise Refused(f"the mesh {object.data.name} itself has other vertices than the {count} samples")
    there = evaluated_coordinates(context, object, count)
    if there is None:
        raise Refused(f"the modifier {culprit(context, object, count)} changes which vertices there are")
    matrix = np.array(object.evaluated_get(context.evaluated_depsgraph_get()).matrix_world, dtype=np.float64)
    moved = there @ matrix[:3, :3].T + matrix[:3, 3]
    if not np.isfinite(moved).all():
        raise Refused("some vertices are at no finite place")
    # Of what did not move, nothing is rounded.
    return sampled.positions + (moved - sampled.local.astype(np.float64))


def evaluated_coordinates(
    context: bpy.types.Context, object: bpy.types.Object, count: int
) -> np.ndarray | None:
    """As `coordinates`, after the modifiers."""
    result = object.evaluated_get(context.evaluated_depsgraph_get())
    mesh = result.to_mesh()
    try:
        return coordinates(mesh, count)
    finally:
        result.to_mesh_clear()


def culprit(context: bpy.types.Context, object: bpy.types.Object, count: int) -> str:
    """The name of the first modifier after which there are other vertices."""
    shown = [(modifier, modifier.show_viewport) for modifier in object.modifiers]
    try:
        for modifier, _ in shown:
            modifier.show_viewport = False
        for modifier, was_shown in shown:
            modifier.show_viewport = was_shown
            if was_shown and evaluated_coordinates(context, object, count) is None:
                return modifier.name
    finally:
        for modifier, was_shown in shown:
            modifier.show_viewport = was_shown
    return "that is the last"


def base(object: bpy.types.Object, sampled: Sampled) -> np.ndarray:
    """Where the mesh has the samples before modifiers: (N, 3), float64, model coordinates."""
    found = coordinates(object.data, len(sampled.positions))
    if found is None:
        raise Refused(f"the mesh {object.data.name} itself has other vertices than the samples")
    return sampled.positions + (found - sampled.local.astype(np.float64))


AROUND = 8
"""Samples that others are interpolated between."""


def interpolation(known: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The known points nearest to each place, (M, 8), the nearest first, and how much each of them counts: what is
    linear is met by least squares."""
    tree = kdtree.KDTree(len(known))
    for i, place in enumerate(known):
        tree.insert(place, i)
    tree.balance()
    count = min(AROUND, len(known))
    nearest = np.array([[i for _, i, _ in tree.find_n(place, count)] for place in places]).reshape(-1, count)
    apart = known[nearest].astype(float) - places[:, None].astype(float)
    reach = np.linalg.norm(apart, axis=2).max(1)[:, None, None]
    columns = np.concatenate([np.ones((*apart.shape[:2], 1)), apart / np.maximum(reach, 1e-30)], axis=2)
    # The thickness of a thin neighbourhood tells nothing.
    parts = np.linalg.pinv(columns, rcond=0.1)[:, 0, :]
    return nearest, parts / parts.sum(1, keepdims=True)


def append(object: bpy.types.Object, before: Sampled, after: Sampled, deformed: Path) -> int:
    """Appends the samples that a refinement added, where it took them: weights in vertex groups and shape keys are
    interpolated between the samples that there were, other attributes are those of the nearest. Gives their number."""
    mesh, old = object.data, len(before.positions)
    more = read_ply(deformed)[0] - after.offset
    nearest, parts = interpolation(before.local, after.local[old:])
    bm = bmesh.new()
    bm.from_mesh(mesh)
    bm.verts.ensure_lookup_table()
    ids = bm.verts.layers.int[ID]
    by_id = {vertex[ids]: vertex for vertex in bm.verts}
    shapes, groups = bm.verts.layers.shape.values(), bm.verts.layers.deform.active
    for i, around, part in zip(range(old, len(after.positions)), nearest.tolist(), parts.tolist()):
        known = [by_id[j] for j in around]
        vertex = bm.verts.new(more[i], known[0])
        vertex[ids] = i
        vertex.select = True
        for shape in shapes:
            vertex[shape] = vertex.co + sum(((v[shape] - v.co) * p for v, p in zip(known, part)), Vector())
        if groups:
            for group in {g for v in known for g in v[groups].keys()}:
                weight = sum(v[groups].get(group, 0.0) * p for v, p in zip(known, part))
                vertex[groups][group] = min(1.0, max(0.0, weight))
        by_id[i] = vertex
    for edge in list(bm.edges):
        bm.edges.remove(edge)
    for corners in after.triangles.tolist():
        try:
            bm.faces.new([by_id[corner] for corner in corners])
        except ValueError:
            # The same triangle from both sides.
            pass
    bm.to_mesh(mesh)
    bm.free()
    mesh.update()
    return len(after.positions) - old
