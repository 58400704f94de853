# SPDX-License-Identifier: GPL-3.0-or-later
"""SIMOD in Blender: whatever Blender does with the samples of a model of any size is done to the model.

It talks to the program `simod` as a process.
"""

import bpy

from . import operators, panel

CLASSES = [*operators.CLASSES, *panel.CLASSES]


def register() -> None:
    """Adds operators and panel."""
    for each in CLASSES:
        bpy.utils.register_class(each)


def unregister() -> None:
    """Takes them away, and stops what goes on."""
    if operators.current and not operators.current.is_over:
        operators.current.cancel()
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
