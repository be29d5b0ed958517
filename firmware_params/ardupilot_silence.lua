-- uav_recon, ArduCopter: land at once if the companion's heartbeats stop. Copy it to APM/scripts on the SD card; SCR_ENABLE 1.
--
-- FS_GCS_ENABLE lands, too, but only after FS_GCS_TIMEOUT (at least 2 s), and then hovers for 4 s before it descends
-- (LAND_WITH_DELAY_MS in ArduCopter's mode_land.cpp). Without the companion there are no poses, so the vehicle would drift beside
-- walls during that time. This script lands like a command, without the pause. ArduCopter's failsafe remains as a backup, except
-- during a landing started here, where it would start its pause half a second later. Therefore FS_GCS_ENABLE is set to 0 until
-- the motors stop; this value is never saved.
--
-- UVR_SILENCE_S: time in s without a heartbeat of MAV_GCS_SYSID (sent at 5 Hz) after which an armed vehicle in GUIDED lands. The
-- parameter exists only while this script runs: uav_recon reads it before arming, and does not arm without it.

local GUIDED, LAND = 4, 9
local CRITICAL = 2
local TABLE, EVERY_MS = 73, 50

assert(param:add_table(TABLE, "UVR_", 1), "uav_recon: no parameter table")
assert(param:add_param(TABLE, 1, "SILENCE_S", 1.5), "uav_recon: no parameter")
local silence_s = Parameter("UVR_SILENCE_S")

local function is_silent()
  local heard_ms = gcs:last_seen()
  return heard_ms > uint32_t(0) and (millis() - heard_ms):tofloat() > 1000.0 * silence_s:get()
end

local fs_gcs, kept = Parameter("FS_GCS_ENABLE"), nil

local function give_back()
  if kept then
    fs_gcs:set(kept)
    kept = nil
  end
end

local function land()
  kept = kept or fs_gcs:get()
  fs_gcs:set(0)
  if vehicle:set_mode(LAND) then
    gcs:send_text(CRITICAL, "Companion silent: landing")
  else
    give_back()
  end
end

local function watch()
  if not arming:is_armed() then
    give_back()
  elseif vehicle:get_mode() == GUIDED and is_silent() then
    land()
  end
  return watch, EVERY_MS
end

return watch()
