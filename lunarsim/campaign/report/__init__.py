"""Report of a campaign: one self-contained HTML file."""

from lunarsim.campaign.report.page import write_report

__all__ = ["write_report"]
