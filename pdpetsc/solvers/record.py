"""How an equilibrium was found, or why not."""

from dataclasses import dataclass, field


class StepFailed(Exception):
    """A load step was not solved; its message says why. Raised on all ranks alike.

    Attributes:
        share: of the step that should be tried instead.
    """

    def __init__(self, message: str, share: float = 0.5):
        super().__init__(message)
        self.share = share


@dataclass
class SolveRecord:
    """How one load step was solved.

    Attributes:
        newton_iterations: linearisations solved, the predictor included.
        linear_iterations: iterations of the Krylov method over all of them.
        residual_norms: |r| after each of them [force].
        residual_scale: what they are compared with, sqrt(|f_ext|^2 + |reactions|^2) [force].
        rounding_floor: whether the step ended because rounding left nothing to gain.
        seconds: wall-clock time.
        arc_length: of the step, where a path is followed [length].
        relaxation_steps: of a damped motion (relaxation.py).
    """

    newton_iterations: int = 0
    linear_iterations: int = 0
    residual_norms: list[float] = field(default_factory=list)
    residual_scale: float = 0.0
    rounding_floor: bool = False
    seconds: float = 0.0
    arc_length: float = 0.0
    relaxation_steps: int = 0
