#!/usr/bin/python3
"""Question: can a mosaic be looked at over HTTP without fetching it?

Serves a GeoTIFF from this machine with range requests, opens it through GDAL's /vsicurl, reads its smallest overview and a window in its
middle, and prints how many bytes that took of how many; before that, what GDAL's own validator of Cloud Optimized GeoTIFFs says.

usage: cog_by_ranges.py MOSAIC.tif
"""
import functools
import http.server
import os
import re
import sys
import threading

from osgeo import gdal
from osgeo_utils.samples import validate_cloud_optimized_geotiff


class RangeHandler(http.server.BaseHTTPRequestHandler):
    """One file, whole or in ranges, counting what is sent."""

    protocol_version = "HTTP/1.1"
    sent_bytes = 0
    requests = 0

    def __init__(self, path, *args):
        self.file_path = path
        super().__init__(*args)

    def log_message(self, *args):
        pass

    def answer(self, with_body):
        if self.path != "/" + os.path.basename(self.file_path):
            self.send_error(404)
            return
        size = os.path.getsize(self.file_path)
        match = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
        begin, end = 0, size
        if match:
            begin = int(match.group(1))
            end = min(size, int(match.group(2)) + 1 if match.group(2) else size)
        self.send_response(206 if match else 200)
        if match:
            self.send_header("Content-Range", f"bytes {begin}-{end - 1}/{size}")
        self.send_header("Accept-Ranges", "bytes")
        self.send_header("Content-Length", str(end - begin))
        self.end_headers()
        RangeHandler.requests += 1
        if not with_body:
            return
        with open(self.file_path, "rb") as file:
            file.seek(begin)
            left = end - begin
            while left > 0:
                block = file.read(min(left, 1 << 16))
                self.wfile.write(block)
                RangeHandler.sent_bytes += len(block)
                left -= len(block)

    def do_GET(self):
        self.answer(True)

    def do_HEAD(self):
        self.answer(False)


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    path = sys.argv[1]
    gdal.UseExceptions()
    warnings, errors, _ = validate_cloud_optimized_geotiff.validate(path, full_check=True)
    print(f"validator: {len(errors)} errors, {len(warnings)} warnings")
    for text in errors + warnings:
        print("  " + text)
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(RangeHandler, path))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    gdal.SetConfigOption("GDAL_DISABLE_READDIR_ON_OPEN", "EMPTY_DIR")
    url = f"/vsicurl/http://127.0.0.1:{server.server_address[1]}/{os.path.basename(path)}"
    local = gdal.Open(path)
    remote = gdal.Open(url)
    size = os.path.getsize(path)
    print(f"file: {remote.RasterXSize} x {remote.RasterYSize} px, {size / 1e6:.1f} MB")
    print(f"opened: {RangeHandler.requests} requests, {RangeHandler.sent_bytes / 1e6:.3f} MB")
    band = remote.GetRasterBand(1)
    overview = band.GetOverview(band.GetOverviewCount() - 1) if band.GetOverviewCount() > 0 else band
    overview.ReadRaster()
    print(f"and its smallest overview, {overview.XSize} x {overview.YSize} px: {RangeHandler.requests} requests, {RangeHandler.sent_bytes / 1e6:.3f} MB")
    side = min(512, remote.RasterXSize, remote.RasterYSize)
    window = ((remote.RasterXSize - side) // 2, (remote.RasterYSize - side) // 2, side, side)
    if band.ReadRaster(*window) != local.GetRasterBand(1).ReadRaster(*window):
        sys.exit("the window read by ranges differs from the file's")
    print(
        f"and {side} x {side} px of its middle: {RangeHandler.requests} requests, {RangeHandler.sent_bytes / 1e6:.3f} MB, "
        f"{100.0 * RangeHandler.sent_bytes / size:.2f} % of the file"
    )
    sys.exit(1 if errors else 0)


if __name__ == "__main__":
    main()
