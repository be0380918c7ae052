"""Building of a region's folder from rasters of orbital products: `he3 region build`.

`recipe` is the input document, `projection` the site's plane on the Moon, `sources` reads rasters with GDAL, `sampling`
brings them to the site's cells, `chemistry` computes helium-3 from them, `writing` writes the folder, `build` composes
these. `sites` and `fetching` are for downloads. It imports `he3`, `schemas` and `services.mission`; modules import
rasterio and pyproj through `geo`, which names the missing extra.
"""
