"""Studies: measure cases, keep their results, and report them."""

from lunarsim.evaluation.comparisons import holm_correction
from lunarsim.evaluation.patch_posterior import PatchPrior, PosteriorSafety, posterior_safety
from lunarsim.evaluation.risk_control import risk_threshold
from lunarsim.evaluation.statistics import Proportion
from lunarsim.studies.command import report_study, run_script, run_study
from lunarsim.studies.report import Metric, Report, metric_table
from lunarsim.studies.results import pack_array, unpack_array
from lunarsim.studies.study import Case, Study

__all__ = [
    "Case",
    "Metric",
    "PatchPrior",
    "PosteriorSafety",
    "Proportion",
    "Report",
    "Study",
    "holm_correction",
    "metric_table",
    "pack_array",
    "posterior_safety",
    "report_study",
    "risk_threshold",
    "run_script",
    "run_study",
    "unpack_array",
]
