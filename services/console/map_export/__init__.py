"""A mission's map as files that geographic tools open: GeoTIFF, GeoPackage, GeoJSON, CSV, STAC, PDS4.

`contents` says what a map consists of and `region_layers` what its region adds, `placement` where it lies on the Moon.
`rasters`, `vectors`, `styles`, `catalogue` and `pds4` each make one kind of file, and `folder` writes them all. The
package stands below the client, which fetches the contents. It imports the libraries of the extra ``geo`` where they
are used.
"""
