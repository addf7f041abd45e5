"""Flight missions: lines over an area, heights over a surface, batteries, files for ground stations."""

from workbench.planning.batteries import Part
from workbench.planning.files import plan_files
from workbench.planning.mission import Aircraft, Mission, plan_mission
from workbench.planning.reached import reached

__all__ = ["Aircraft", "Mission", "Part", "plan_files", "plan_mission", "reached"]
