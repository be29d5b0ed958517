-- uav_recon, ArduCopter: land at once when the companion falls silent. Copy it to APM/scripts of the card; SCR_ENABLE 1.
--
-- FS_GCS_ENABLE lands too, but FS_GCS_TIMEOUT later, 2 s at least, and then hovers for four seconds before it descends
-- (LAND_WITH_DELAY_MS in ArduCopter's mode_land.cpp). The companion's poses are gone with it, so all of that is blind drift
-- beside walls. This lands as a command does, without the wait. ArduCopter's own failsafe stays behind it, but for the landing
-- that this began: it would begin its wait then, half a second on. FS_GCS_ENABLE is 0 until the motors stand, and never saved so.
--
-- UVR_SILENCE_S: seconds without a heartbeat of MAV_GCS_SYSID (it comes at 5 Hz) in GUIDED, armed. The parameter is there only
-- while this script runs: uav_recon reads it before it arms, and does not arm without it.

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
