"""mosaic"""
