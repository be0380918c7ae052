"""The operator's web page: served by the console, with nothing from elsewhere."""
