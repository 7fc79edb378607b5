-- upwash's dead man: has an ArduCopter return, or land, when the program that flies it falls silent.
--
-- The program says in its heartbeats for how long it may be silent, and when it needs nobody to watch. It acts in
-- GUIDED and in flight alone, and only if it has heard the program there since the vehicle was armed. Nothing is kept
-- over a restart. Why it is like this: docs/decisions/dead-man.md of upwash.

local VERSION = @VERSION@
local TABLE, PREFIX = 171, "UPW_"
local HEARTBEAT, COMPANION, ONBOARD_CONTROLLER = 0, 191, 18
local MAGIC = 0x5550 -- in the upper half of the heartbeat's custom_mode
local GUIDED, RTL, LAND = 4, 6, 9
local MODES = {[1] = RTL, [2] = LAND} -- by the promise's action; 0 is a goodbye
local NAMES = {[RTL] = "RTL", [LAND] = "LAND"}
local TICK_MS = 200
local EARLY_MS = 1000 -- so that it acts within the time and not after it
local AGAIN_MS = 5000
local WARNING, INFO = 4, 6

local promised_ms, promised_mode, heard_ms -- nil: nobody is to be missed
local was_armed = false
local announced_ms

local system = param:get("MAV_SYSID") or param:get("SYSID_THISMAV")

local function forget()
  if promised_ms then
    promised_ms, announced_ms = nil, nil
    param:set(PREFIX .. "SILENCE_S", 0)
  end
end

local function may_be_watched()
  return not (arming:is_armed() and vehicle:get_likely_flying()) or vehicle:get_mode() == GUIDED
end

local function take_promise(mode, tenths)
  if tenths == 0 or not may_be_watched() then return end
  if promised_ms ~= tenths * 100 then param:set(PREFIX .. "SILENCE_S", tenths / 10) end
  promised_ms, promised_mode, heard_ms, announced_ms = tenths * 100, mode, millis(), nil
end

-- Takes a parsed message in ArduPilot's own layout: 12 bytes of header, sender at 8 and 9, then the payload.
local function hear(message)
  local from_system, from_component = string.unpack("<BB", message, 8)
  local custom_mode, kind = string.unpack("<I4B", message, 13)
  if from_system ~= system or from_component ~= COMPANION or kind ~= ONBOARD_CONTROLLER then return end
  if custom_mode >> 16 ~= MAGIC then return end
  local action = (custom_mode >> 13) & 7
  if action == 0 then
    forget()
  elseif MODES[action] then
    take_promise(MODES[action], custom_mode & 8191)
  end
end

local function act()
  if not announced_ms then -- said a tick before the mode changes: whoever sees that knows why
    gcs:send_text(WARNING, "upwash: companion silent, " .. NAMES[promised_mode])
    announced_ms = millis()
  elseif not vehicle:set_mode(promised_mode) then
    if vehicle:set_mode(LAND) then
      gcs:send_text(WARNING, "upwash: companion silent, LAND instead")
    elseif millis() - announced_ms > AGAIN_MS then
      announced_ms = nil
    end
  end
end

-- Before anything is heard: only what is heard after it counts.
local function notice_arming()
  local armed = arming:is_armed()
  if armed and not was_armed then forget() end
  was_armed = armed
end

local function watch()
  if not promised_ms then return end
  if not may_be_watched() then
    forget() -- a pilot, a fail-safe, or the program on its own way down
  elseif millis() - heard_ms >= promised_ms - EARLY_MS then
    if was_armed and vehicle:get_likely_flying() then act() else forget() end
  end
end

local function update()
  notice_arming()
  local message = mavlink:receive_chan()
  while message do
    hear(message)
    message = mavlink:receive_chan()
  end
  watch()
  return update, TICK_MS
end

if not (param:add_table(TABLE, PREFIX, 2) and param:add_param(TABLE, 1, "VERSION", VERSION)
    and param:add_param(TABLE, 2, "SILENCE_S", 0)) then
  gcs:send_text(WARNING, "upwash: parameter table " .. TABLE .. " is another script's")
  return
end
param:set(PREFIX .. "VERSION", VERSION)
param:set(PREFIX .. "SILENCE_S", 0)
mavlink:init(20, 1)
mavlink:register_rx_msgid(HEARTBEAT)
gcs:send_text(INFO, "upwash: dead man " .. VERSION .. " is ready")
return update()
