"""The report of a campaign: one HTML file that needs nothing else."""

from lunarsim.campaign.report.page import write_report

__all__ = ["write_report"]
