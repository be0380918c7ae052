"""What QGIS itself finds in an exported map, printed as JSON; run by an interpreter that has QGIS (Debian: qgis).

qgis_reader.py FOLDER LONGITUDE LATITUDE
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

from qgis.core import (
    Qgis,
    QgsApplication,
    QgsCoordinateReferenceSystem,
    QgsCoordinateTransform,
    QgsPointXY,
    QgsProject,
    QgsRasterBandStats,
    QgsRasterLayer,
    QgsVectorLayer,
)

MOON = "IAU_2015:30100"


def main(folder: Path, longitude: float, latitude: float) -> None:
    application = QgsApplication([], False)
    application.initQgis()
    moon = QgsCoordinateReferenceSystem(MOON)
    found = {"version": Qgis.QGIS_VERSION, "rasters": {}, "vectors": {}}
    for path in sorted(folder.glob("*.tif")):
        layer = QgsRasterLayer(str(path), path.stem)
        provider, extent = layer.dataProvider(), layer.extent()
        there = QgsCoordinateTransform(moon, layer.crs(), QgsProject.instance()).transform(longitude, latitude)
        statistics = provider.bandStatistics(1, QgsRasterBandStats.All)
        found["rasters"][path.stem] = {
            "valid": layer.isValid() and layer.crs().isValid(),
            "size": [layer.height(), layer.width()],
            "extent_m": [extent.xMinimum(), extent.yMinimum(), extent.xMaximum(), extent.yMaximum()],
            "value": provider.sample(QgsPointXY(there), 1)[0],
            "statistics": [statistics.minimumValue, statistics.maximumValue, statistics.mean, statistics.stdDev],
            "no_data": provider.sourceNoDataValue(1) if provider.sourceHasNoDataValue(1) else None,
            "style": layer.loadNamedStyle(str(path.with_suffix(".qml")))[1],
            "renderer": layer.renderer().type(),
        }
    for name in ("samples", "driven_path", "site"):
        layer = QgsVectorLayer(f"{folder / 'map.gpkg'}|layername={name}", name, "ogr")
        to_moon = QgsCoordinateTransform(layer.crs(), moon, QgsProject.instance())
        features = list(layer.getFeatures())
        first = [to_moon.transform(QgsPointXY(next(each.geometry().vertices()))) for each in features]
        found["vectors"][name] = {
            "valid": layer.isValid() and layer.crs().isValid(),
            "first_vertices_deg": [[point.x(), point.y()] for point in first],
            "fields": {field.name(): [each[field.name()] for each in features] for field in layer.fields()},
        }
    sys.stdout.write(json.dumps(found, default=str))
    sys.stdout.flush()
    os._exit(0)  # QGIS may crash while its objects are taken apart in no particular order


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3]))
