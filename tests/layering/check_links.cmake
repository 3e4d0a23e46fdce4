# cmake -DPROGRAM=... -DREADELF=... -P check_links.cmake: fails when PROGRAM needs a library that opens pixels.
execute_process(COMMAND "${READELF}" -d "${PROGRAM}" OUTPUT_VARIABLE dynamic RESULT_VARIABLE code)
if(NOT code EQUAL 0 OR NOT dynamic MATCHES "NEEDED")
  message(FATAL_ERROR "cannot read the dynamic section of ${PROGRAM}; was it built?")
endif()
string(REGEX MATCHALL "lib(opencv|gdal|av[a-z]+|swscale)[^]]*" pixel_libraries "${dynamic}")
if(pixel_libraries)
  message(FATAL_ERROR "${PROGRAM} links ${pixel_libraries}; the coordinator never opens a pixel")
endif()
