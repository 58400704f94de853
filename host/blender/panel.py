# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel in the sidebar of the 3D view, and the preferences."""

import bpy

from . import operators, samples


class SIMOD_PT_panel(bpy.types.Panel):
    """Models of any size"""

    bl_idname = "SIMOD_PT_panel"
    bl_label = "SIMOD"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "SIMOD"

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        job = operators.current
        if job and not job.is_over:
            row = layout.row()
            row.progress(factor=job.fraction, text=job.progress())
            row.operator("simod.cancel", text="", icon="X")
        layout.operator("simod.import_samples", icon="IMPORT")
        column = layout.column(align=True)
        column.operator("simod.write_model", icon="EXPORT")
        column.operator("simod.write_frames", icon="RENDER_ANIMATION")
        layout.operator("simod.refine", icon="MOD_SUBSURF")
        if samples.is_sampled(context.object):
            layout.label(text=f"{len(context.object.data.vertices):,} samples", icon="POINTCLOUD_DATA")
        for line in operators.last_report:
            layout.label(text=line)


class SimodPreferences(bpy.types.AddonPreferences):
    """Where the program is."""

    bl_idname = __package__ or "simod"

    program: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Program", description="The program simod; the one on the path where none is given", subtype="FILE_PATH"
    )

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.prop(self, "program")


CLASSES = [SimodPreferences, SIMOD_PT_panel]
