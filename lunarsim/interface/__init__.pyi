from lunarsim.interface.server import serve as serve
from lunarsim.parts.program_permission import allow_programs as allow_programs
