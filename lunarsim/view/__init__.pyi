from lunarsim.view.film import save_film as save_film
from lunarsim.view.viewer import save_recording as save_recording
