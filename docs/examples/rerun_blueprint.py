"""Writes a blueprint for Rerun that shows the vehicles of a log as axes in three dimensions; needs rerun-sdk.

python docs/examples/rerun_blueprint.py 4 fleet.rbl && rerun runs/latest/run.mcap fleet.rbl
"""

import sys

import rerun as rr
import rerun.blueprint as rrb

poses = [f"/uuv/{i}/pose" for i in range(1, int(sys.argv[1]) + 1)]
view = rrb.Spatial3DView(
    contents=[f"+ {entity}" for entity in (*poses, "/transforms")],
    spatial_information=rrb.SpatialInformation(target_frame="map"),
    overrides={pose: [rr.TransformAxes3D(2.0)] for pose in poses},  # m
)
rrb.Blueprint(view).save("run", sys.argv[2])  # Rerun calls what it imports after the file, run.mcap
