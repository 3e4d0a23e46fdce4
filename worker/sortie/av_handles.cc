#include "worker/sortie/av_handles.h"

namespace trem {

int OpenContainer(const std::string& path, AVFormatContext** context) {
  AVDictionary* options = nullptr;
  // "file:" keeps a name with a colon from being another protocol.
  av_dict_set(&options, "protocol_whitelist", "file", 0);
  av_dict_set(
      &options, "format_whitelist",
      "mpegts,mpegtsraw,mov,matroska,avi,asf,flv,mpeg,mpegvideo,m4v,h264,hevc,mjpeg,mjpeg_2000,mxf,mxf_opatom,nut,ogg,dv,gxf,vc1,ivf,obu,"
      "yuv4mpegpipe,rm,wtv,swf,gif,apng,live_flv,h261,h263,cavsvideo,dnxhd,dirac,av1,rawvideo",
      0);
  const int error = avformat_open_input(context, ("file:" + path).c_str(), nullptr, &options);
  av_dict_free(&options);
  return error;
}

}  // namespace trem
