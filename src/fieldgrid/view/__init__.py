"""View: maps as a web page, for looking, asking why, and comparing; complete without a network.

* `server`: `view_maps` opens a socket, a link with a token, and a browser; `listening`: sockets
  that bound their clients.
* `app`: what each address answers; `security`: who may ask it.
* `maps`, `farms`: the maps that are shown, opened anew for each request.
* `about`, `layers`, `drives`, `features`, `why`, `pictures`: what the page is told.
* `actions`, `exports`: what the page may change or save.
* `report`: `write_report`, a map as one HTML file.
* `page`, `static`: the page itself, built from `page/` at the top of the source tree.

It computes no layers and keeps nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fieldgrid.core.doors import door

if TYPE_CHECKING:
    from fieldgrid.view import page as page
    from fieldgrid.view.listening import LOOPBACK as LOOPBACK, listen as listen
    from fieldgrid.view.report import write_report as write_report
    from fieldgrid.view.security import (
        Guard as Guard,
        loopback_access as loopback_access,
        network_access as network_access,
    )
    from fieldgrid.view.server import (
        in_link as in_link,
        make_server as make_server,
        view_maps as view_maps,
    )
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
