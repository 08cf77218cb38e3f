# What is installed, and the Debian package made of it (`tools/dev package`). The daemon looks into /etc/clampd and the
# units name /usr/bin, so both stand at fixed places.

include(GNUInstallDirs)

# The package's station differs from a checkout's: a real bus, records and token where systemd keeps them.
set(STATION_CONFIGURATION ${CMAKE_BINARY_DIR}/package/station.toml)
set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${CMAKE_SOURCE_DIR}/configs/station.toml)
file(READ ${CMAKE_SOURCE_DIR}/configs/station.toml STATION_TEXT)
foreach(SETTING "interface = \"\"    =>interface = \"can0\""
                "# database = \"checks.sqlite\"=>database = \"/var/lib/clampd/checks.sqlite\""
                "# token_file = \"token\"=>token_file = \"/run/clampd/token\"")
  string(REGEX MATCH "^(.*)=>(.*)$" SETTING "${SETTING}")
  string(REPLACE "\n${CMAKE_MATCH_1}" "\n${CMAKE_MATCH_2}" CHANGED_TEXT "${STATION_TEXT}")
  if(CHANGED_TEXT STREQUAL STATION_TEXT)
    message(FATAL_ERROR "configs/station.toml has no line '${CMAKE_MATCH_1}', which the package replaces")
  endif()
  set(STATION_TEXT "${CHANGED_TEXT}")
endforeach()
file(CONFIGURE OUTPUT ${STATION_CONFIGURATION} CONTENT "${STATION_TEXT}" @ONLY)

install(TARGETS clampd clampctl clampd-plant clampd-worker)
install(DIRECTORY configs/drives configs/brakes configs/prometheus DESTINATION ${CMAKE_INSTALL_DATADIR}/clampd)
install(FILES ${STATION_CONFIGURATION} configs/brake.dbc configs/limits.toml configs/plant.toml configs/sheet.toml
  configs/trajectory.csv configs/trajectory-sliding.csv configs/trajectory-breakaway.csv
  DESTINATION /etc/clampd)
install(FILES systemd/clampd-can.default DESTINATION /etc/default RENAME clampd-can)
install(FILES systemd/clampd.service systemd/clampd.socket systemd/clampd-can@.service systemd/clampd-worker@.service
  DESTINATION /lib/systemd/system)
install(FILES systemd/clampd.sysusers DESTINATION /usr/lib/sysusers.d RENAME clampd.conf)
install(FILES systemd/clampd.tmpfiles DESTINATION /usr/lib/tmpfiles.d RENAME clampd.conf)
install(FILES systemd/clampd.modules DESTINATION /usr/lib/modules-load.d RENAME clampd.conf)
install(FILES systemd/clampd.udev DESTINATION /lib/udev/rules.d RENAME 60-clampd.rules)
install(FILES README.md ARCHITECTURE.md CHANGELOG.md DESTINATION ${CMAKE_INSTALL_DOCDIR})
install(DIRECTORY docs/ DESTINATION ${CMAKE_INSTALL_DOCDIR}/docs)
install(FILES LICENSE DESTINATION ${CMAKE_INSTALL_DOCDIR} RENAME copyright)
install(DIRECTORY systemd/examples DESTINATION ${CMAKE_INSTALL_DOCDIR})

set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_CONTACT "clampd <clampd@localhost>")
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CPACK_INSTALL_DEFAULT_DIRECTORY_PERMISSIONS
  OWNER_READ OWNER_WRITE OWNER_EXECUTE GROUP_READ GROUP_EXECUTE WORLD_READ WORLD_EXECUTE)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_COMPRESSION_TYPE xz)
set(CPACK_DEBIAN_PACKAGE_SECTION misc)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_PACKAGE_DEPENDS "systemd (>= 252), udev, iproute2, kmod, init-system-helpers, passwd")
set(CPACK_DEBIAN_PACKAGE_RECOMMENDS "gnuplot-nox")
set(CPACK_DEBIAN_PACKAGE_SUGGESTS "can-utils")
set(CPACK_DEBIAN_PACKAGE_CONTROL_STRICT_PERMISSION ON)
set(CPACK_DEBIAN_PACKAGE_CONTROL_EXTRA)
foreach(SCRIPT conffiles postinst prerm postrm)
  list(APPEND CPACK_DEBIAN_PACKAGE_CONTROL_EXTRA ${CMAKE_SOURCE_DIR}/systemd/debian/${SCRIPT})
endforeach()
include(CPack)
