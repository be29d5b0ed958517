-- uav_recon, ArduCopter: land at once if the companion's heartbeats stop. Copy it to APM/scripts on the SD card; SCR_ENABLE 1.
--
-- FS_GCS_ENABLE lands, too, but only after FS_GCS_TIMEOUT (at least 2 s), and then hovers for 4 s before it descends
-- (LAND_WITH_DELAY_MS in ArduCopter's mode_land.cpp). Without the companion there are no poses, so the vehicle would drift beside
-- walls during that time. This script lands like a command, without the pause. ArduCopter's failsafe remains as a backup, except
-- during a landing started here, where it would start its pause half a second later. Therefore FS_GCS_ENABLE is set to 0 until
-- the motors stop; this value is never saved.
--
-- The companion is the sender with the system id MAV_GCS_SYSID, the component id UVR_COMP_ID and the type of an onboard
-- controller. ArduPilot's failsafe (and gcs:last_seen) asks for the system id only: a MAVSDK program or a ground station with the
-- same system id would hide that the companion is dead. Therefore this script reads the heartbeats itself.
--
-- UVR_SILENCE_S: time in s without a heartbeat of the companion (sent at 5 Hz) after which an armed vehicle in GUIDED lands. The
-- parameters exist only while this script runs: uav_recon reads them before arming, and does not arm without them.

local GUIDED, LAND = 4, 9
local CRITICAL = 2
local TABLE, EVERY_MS = 73, 50
local HEARTBEAT, ONBOARD_CONTROLLER = 0, 18
local QUEUE = 20 -- heartbeats of all senders between two steps; ArduPilot allows 25
local WIDE_BYTES = 299 -- of a mavlink_message_t with a system id of 32 bits; with one of 8 bits it has 291

assert(param:add_table(TABLE, "UVR_", 2), "uav_recon: no parameter table")
assert(param:add_param(TABLE, 1, "SILENCE_S", 1.5), "uav_recon: no parameter")
assert(param:add_param(TABLE, 2, "COMP_ID", 191), "uav_recon: no parameter")
local silence_s, component = Parameter("UVR_SILENCE_S"), Parameter("UVR_COMP_ID")
local system = Parameter()
assert(system:init("MAV_GCS_SYSID") or system:init("SYSID_MYGCS"), "uav_recon: no system id") -- the latter before 4.7
mavlink:init(QUEUE, 1)
mavlink:register_rx_msgid(HEARTBEAT)

local heard_ms = nil

-- message: a mavlink_message_t; the type is the fifth byte of a heartbeat
local function is_companion(message)
  local wide = #message >= WIDE_BYTES
  local from_system, from_component = string.unpack(wide and "<I4B" or "<BB", message, 8)
  local kind = string.unpack("<B", message, (wide and 16 or 13) + 4)
  return from_system == system:get() and from_component == component:get() and kind == ONBOARD_CONTROLLER
end

local function listen()
  local message = mavlink:receive_chan()
  while message do
    if is_companion(message) then
      heard_ms = millis()
    end
    message = mavlink:receive_chan()
  end
end

local function is_silent()
  return heard_ms ~= nil and (millis() - heard_ms):tofloat() > 1000.0 * silence_s:get()
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
  listen()
  if not arming:is_armed() then
    give_back()
  elseif vehicle:get_mode() == GUIDED and is_silent() then
    land()
  end
  return watch, EVERY_MS
end

return watch()
