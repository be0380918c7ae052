"""Building of a region's folder from rasters of orbital products: `he3 region build`.

`recipe` is the input document, `projection` the site's plane on the Moon, `sources` reads rasters with GDAL, `sampling`
brings them to the site's cells, `chemistry` makes helium-3 of them, `writing` writes the folder, `build` composes
these. `sites` and `fetching` are for downloads. It imports `he3`, `schemas` and `services.mission`; what needs rasterio
or pyproj asks `geo` for it, which names the extra if it is missing.
"""
