"""The operator's web page: served by the console, without resources from other servers."""
