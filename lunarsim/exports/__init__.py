"""Export of saved flights to files of other programs."""

from lunarsim.exports.formats import (
    DEFAULT_EPOCH,
    FORMATS,
    ExportFormat,
    ExportOptions,
    export_flight,
)

__all__ = ["DEFAULT_EPOCH", "FORMATS", "ExportFormat", "ExportOptions", "export_flight"]
