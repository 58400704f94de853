# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panel does: import samples, write the model, refine."""

from pathlib import Path

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from . import samples
from .files import Sampled, write_ply
from .jobs import Job, program

PRESETS = [
    ("20000", "Draft", "20 000 samples: to try something"),
    ("100000", "Usual", "100 000 samples"),
    ("200000", "Fine", "200 000 samples"),
    ("500000", "Very fine", "500 000 samples: Blender gets slow"),
    ("0", "Other", "As many as said"),
]

MOST_BALLS = 100
"""That a selection is told by."""

current: Job | None = None
"""What the program does now, or did last."""
last_report: list[str] = []
"""What became of it, for the panel."""


def preferences_program(context: bpy.types.Context) -> str:
    """What the preferences say."""
    addon = context.preferences.addons.get(__package__ or "")
    return getattr(addon.preferences, "program", "") if addon else ""


def begin(job: Job, wait: bool) -> None:
    """Starts a job, and looks at it now and then, or until it is over."""
    global current
    current = job.start()
    last_report[:] = []
    if wait or bpy.app.background:
        job.wait()
        look()
    else:
        bpy.app.timers.register(look, first_interval=0.2)


def look() -> float | None:
    """Looks at the job; when to look again."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()
    job = current
    if job is None:
        return None
    if not job.is_over:
        return 0.2
    if job.error:
        last_report[:] = [f"{job.what}: {job.error}"] + ([job.hint] if job.hint else [])
    else:
        last_report[:] = [f"{job.what}: done in {job.seconds:.1f} s"]
        try:
            if job.on_done:
                job.on_done(job)
        except (OSError, ValueError, samples.Refused) as e:
            job.error = str(e)
            last_report[:] = [f"{job.what}: {e}"]
    job.close()
    return None


def tell(job: Job) -> None:
    """Adds what the program found out."""
    report = job.report
    if "vertices" in report:
        last_report.append(f"{report['vertices']:,} vertices by {report.get('samples', 0):,} samples")
    expected = report.get("expected_error")
    errors = expected if isinstance(expected, list) else [expected]
    worst = [e["worst"] for e in errors if e]
    if worst:
        last_report.append(f"expected error at most {max(worst):.1e} of the diagonal")
    if report.get("folded_samples"):
        last_report.append(f"folded at {report['folded_samples']} samples")


class Operator(bpy.types.Operator):
    """What all have in common: one job at a time, errors as reports."""

    wait: BoolProperty(name="Wait", description="Wait until the work is done", default=False, options={"HIDDEN"})  # type: ignore[valid-type]

    def execute(self, context: bpy.types.Context) -> set[str]:
        if current and not current.is_over:
            self.report({"ERROR"}, "the program is at work: cancel that first")
            return {"CANCELLED"}
        try:
            begin(self.job(context), self.wait)
        except (OSError, samples.Refused) as e:
            last_report[:] = [str(e)]
            self.report({"ERROR"}, str(e))
            return {"CANCELLED"}
        if current and current.is_over and current.error:
            self.report({"ERROR"}, "\n".join(last_report))
            return {"CANCELLED"}
        return {"FINISHED"}

    def job(self, context: bpy.types.Context) -> Job:
        """What there is to do."""
        raise NotImplementedError


class OfSamples(Operator):
    """What is done to the active object, which is one of samples."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return samples.is_sampled(context.object)


class SIMOD_OT_import(Operator):
    """Sample a model of any size, and import the samples"""

    bl_idname = "simod.import_samples"
    bl_label = "Import Samples"
    bl_options = {"REGISTER"}

    filepath: StringProperty(name="Model", subtype="FILE_PATH")  # type: ignore[valid-type]
    folder: StringProperty(  # type: ignore[valid-type]
        name="Folder",
        description="Folder of the sampled model; beside the model where none is given",
        subtype="DIR_PATH",
    )
    preset: EnumProperty(name="Samples", items=PRESETS, default="100000")  # type: ignore[valid-type]
    samples: IntProperty(name="Other", default=50_000, min=4)  # type: ignore[valid-type]

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def job(self, context: bpy.types.Context) -> Job:
        model = Path(bpy.path.abspath(self.filepath))
        folder = Path(bpy.path.abspath(self.folder)) if self.folder else model.with_suffix(".simod")
        count = int(self.preset) or self.samples
        command = [program(preferences_program(context)), "--json", "sample", str(model), "-o", str(folder)]
        job = Job("sampling", [[*command, "--samples", str(count)]])

        def done(job: Job) -> None:
            samples.new_object(bpy.context, Sampled.load(folder))
            tell(job)

        job.on_done = done
        return job


class SIMOD_OT_write(OfSamples):
    """Write the full model as its samples are deformed now, in the background"""

    bl_idname = "simod.write_model"
    bl_label = "Write Full Model"

    filepath: StringProperty(name="Deformed Model", subtype="FILE_PATH")  # type: ignore[valid-type]
    normals: EnumProperty(  # type: ignore[valid-type]
        name="Normals",
        items=[
            ("transform", "Turn", "Turn the model's normals with the surface"),
            ("keep", "Keep", "Keep the bytes of the model's normals"),
            ("drop", "Drop", "Leave the normals out"),
        ],
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def job(self, context: bpy.types.Context) -> Job:
        simod = program(preferences_program(context))
        sampled, out = samples.sampled_of(context.object), Path(bpy.path.abspath(self.filepath))
        positions = samples.evaluated(context, context.object, sampled)
        job = Job("writing the model", [])
        deformed = job.folder / "deformed.ply"
        write_ply(deformed, positions)
        job.commands.append(
            [simod, "--json", "reconstruct", str(sampled.folder), "--deformed", str(deformed), "-o", str(out)]
            + ["--normals", self.normals]
        )
        job.on_done = tell
        return job


class SIMOD_OT_write_frames(OfSamples):
    """Write a full model for each frame of a range, in the background; who is near whom is found out once"""

    bl_idname = "simod.write_frames"
    bl_label = "Write Frames"

    filepath: StringProperty(  # type: ignore[valid-type]
        name="Deformed Models", description="{} stands for the frame", subtype="FILE_PATH"
    )
    start: IntProperty(name="First", default=1)  # type: ignore[valid-type]
    end: IntProperty(name="Last", default=24)  # type: ignore[valid-type]

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.start, self.end = context.scene.frame_start, context.scene.frame_end
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def job(self, context: bpy.types.Context) -> Job:
        simod = program(preferences_program(context))
        sampled, out = samples.sampled_of(context.object), Path(bpy.path.abspath(self.filepath))
        if "{}" not in out.name:
            out = out.with_name(f"{out.stem}-{{}}{out.suffix}")
        frames, before = range(self.start, self.end + 1), context.scene.frame_current
        if not frames:
            raise samples.Refused("the last frame comes before the first")
        job = Job("writing frames", [])
        try:
            for frame in frames:
                context.scene.frame_set(frame)
                write_ply(job.folder / f"frame-{frame:04}.ply", samples.evaluated(context, context.object, sampled))
        except samples.Refused:
            job.close()
            raise
        finally:
            context.scene.frame_set(before)
        pattern = str(job.folder / "frame-*.ply")
        job.commands.append([simod, "--json", "bind", str(sampled.folder)])
        job.commands.append(
            [simod, "--json", "reconstruct", str(sampled.folder), "--deformed", pattern, "-o", str(out)]
        )
        job.on_done = tell
        return job


class SIMOD_OT_refine(OfSamples):
    """Append samples where vertices are selected; the edit stays as it is"""

    bl_idname = "simod.refine"
    bl_label = "Refine Selection"

    factor: FloatProperty(name="Times as many", default=4.0, min=1.01, max=1000.0)  # type: ignore[valid-type]

    def job(self, context: bpy.types.Context) -> Job:
        simod = program(preferences_program(context))
        object = context.object
        if object.mode == "EDIT":
            bpy.ops.object.mode_set(mode="OBJECT")
        before = samples.sampled_of(object)
        balls = selection(object, before)
        job = Job("refining", [])
        write_ply(job.folder / "base.ply", samples.base(object, before))
        more = job.folder / "more.ply"
        shapes = [f"--sphere={','.join(repr(float(x)) for x in ball)}" for ball in balls]
        job.commands.append(
            [simod, "--json", "refine", str(before.folder), *shapes, "--factor", str(self.factor)]
            + ["--deformed", str(job.folder / "base.ply"), "-o", str(more)]
        )

        def done(job: Job) -> None:
            added = samples.append(object, before, Sampled.load(before.folder), more)
            last_report.append(f"{added:,} samples more")

        job.on_done = done
        return job


class SIMOD_OT_cancel(bpy.types.Operator):
    """Stop what the program does; nothing is left half done"""

    bl_idname = "simod.cancel"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return current is not None and not current.is_over

    def execute(self, context: bpy.types.Context) -> set[str]:
        if current:
            current.cancel()
        return {"FINISHED"}


def selection(object: bpy.types.Object, sampled: Sampled) -> np.ndarray:
    """Balls around the selected samples at rest: (B, 4), centre and radius, model coordinates."""
    mesh = object.data
    chosen = np.empty(len(mesh.vertices), bool)
    mesh.vertices.foreach_get("select", chosen)
    ids = np.empty(len(mesh.vertices), np.int32)
    mesh.attributes[samples.ID].data.foreach_get("value", ids)
    places = sampled.positions[ids[chosen]]
    if not len(places):
        raise samples.Refused("no vertex is selected")
    low, high = places.min(0), places.max(0)
    # As far apart as samples are, about.
    everything = sampled.positions.max(0) - sampled.positions.min(0)
    reach = float(np.linalg.norm(everything)) / np.sqrt(len(sampled.positions))
    edge = max(reach, float((high - low).max()) / 2)
    cells = np.floor((places - low) / edge).astype(np.int64)
    while True:
        # Halved as long as the balls are few.
        finer = np.floor((places - low) / (edge / 2)).astype(np.int64)
        if edge / 2 < reach or len(np.unique(finer, axis=0)) > MOST_BALLS:
            break
        cells, edge = finer, edge / 2
    balls = []
    for cell in np.unique(cells, axis=0):
        of_cell = places[(cells == cell).all(1)]
        middle = of_cell.mean(0)
        balls.append([*middle, np.linalg.norm(of_cell - middle, axis=1).max() + reach / 2])
    return np.array(balls)


CLASSES = [SIMOD_OT_import, SIMOD_OT_write, SIMOD_OT_write_frames, SIMOD_OT_refine, SIMOD_OT_cancel]
