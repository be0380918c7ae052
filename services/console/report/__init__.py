"""What a mission leaves behind and shows on its way: progress, the report, pictures, files of numbers."""
