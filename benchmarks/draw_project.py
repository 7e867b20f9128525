"""Draw a QGIS project as QGIS opens it: `python3 benchmarks/draw_project.py PROJECT.qgz OUT.png`.

It runs in the Python of Debian's python3-qgis, not in this project's environment.
"""

from __future__ import annotations

import os
import sys

SIDE_PX = 800


def main() -> None:
    """Draw the visible layers of the project of the command line over their extent."""
    os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
    from qgis.core import (
        QgsApplication,
        QgsMapRendererSequentialJob,
        QgsMapSettings,
        QgsProject,
        QgsRasterLayer,
    )
    from qgis.PyQt.QtCore import QSize

    application = QgsApplication([], False)
    application.initQgis()
    project = QgsProject.instance()
    if not project.read(sys.argv[1]):
        sys.exit(f"{sys.argv[1]}: {project.error()}")
    layers = [node.layer() for node in project.layerTreeRoot().findLayers() if node.isVisible()]
    settings = QgsMapSettings()
    settings.setLayers(layers)
    settings.setDestinationCrs(project.crs())
    settings.setBackgroundColor(project.backgroundColor())
    settings.setOutputSize(QSize(SIDE_PX, SIDE_PX))
    settings.setExtent(next(one for one in layers if isinstance(one, QgsRasterLayer)).extent())
    settings.setFlag(QgsMapSettings.Antialiasing)
    job = QgsMapRendererSequentialJob(settings)
    job.start()
    job.waitForFinished()
    job.renderedImage().save(sys.argv[2])
    sys.stdout.flush()
    os._exit(0)  # QGIS may crash when it is taken down in the wrong order


if __name__ == "__main__":
    main()
