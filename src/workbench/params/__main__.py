"""Write ``params.yaml`` of the present folder anew: its values, or the defaults, with all comments."""

from pathlib import Path

from workbench.params import Parameters, load_parameters, render_parameters

if __name__ == "__main__":
    target = Path("params.yaml")
    parameters = load_parameters(target) if target.exists() else Parameters()
    target.write_text(render_parameters(parameters), encoding="utf-8")
