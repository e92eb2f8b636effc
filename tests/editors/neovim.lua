-- Opens PitEscape, does by the interface of Neovim what one does with keys, and writes what comes of it to $SEEN as JSON.

local seen = {}

local function wait(what, condition)
  -- Keys are read between two steps, and never within one.
  for _ = 1, 1000 do
    if condition() then return end
    local here = coroutine.running()
    vim.defer_fn(function() coroutine.resume(here) end, 20)
    coroutine.yield()
  end
  error("timed out waiting for " .. what)
end

local function text() return table.concat(vim.api.nvim_buf_get_lines(0, 0, -1, false), "\n") end

local function replace(old, new) vim.cmd("silent %substitute/\\V" .. old .. "/" .. new .. "/") end

local function go_to(pattern, further)
  vim.fn.cursor(1, 1)
  local place = vim.fn.searchpos("\\V" .. pattern, "cW")
  vim.fn.cursor(place[1], place[2] + further)
end

local function found()
  return vim.tbl_map(function(one)
    local line = vim.api.nvim_buf_get_lines(0, one.lnum, one.lnum + 1, false)[1]
    return { one.code, line:sub(one.col + 1, one.end_col) }
  end, vim.diagnostic.get(0))
end

local function floating()
  for _, window in ipairs(vim.api.nvim_list_wins()) do
    if vim.api.nvim_win_get_config(window).relative ~= "" then return window end
  end
end

local function ask()
  vim.cmd.edit("scenarios/pit_escape.yaml")
  wait("the server", function() return #vim.lsp.get_clients({ bufnr = 0 }) > 0 end)
  local client = vim.lsp.get_clients({ bufnr = 0 })[1]
  wait("its first words", function() return client.initialized end)

  replace("gyro: {type: gyro,", '"😀ü": {type: gyros,')
  wait("findings", function() return #found() > 0 end)
  seen.findings = found()

  go_to("gyros", 2)
  local is_fix = function(action) return action.title:find("Replace", 1, true) ~= nil end
  vim.lsp.buf.code_action({ apply = true, filter = is_fix })
  wait("the fix", function() return text():find("type: gyro,", 1, true) ~= nil end)
  seen.fixed = vim.api.nvim_get_current_line()
  vim.cmd("silent earlier 1f")
  wait("the end of the findings", function() return #found() == 0 end)

  replace("timestep: 32", "timestop: 32")
  wait("a finding", function() return #found() > 0 end)
  vim.lsp.buf.code_action({ apply = true, context = { only = { "source.fixAll.deepbots" }, diagnostics = {} } })
  wait("all fixes", function() return text():find("timestep: 32", 1, true) ~= nil end)
  wait("the end of the findings", function() return #found() == 0 end)

  go_to("reach > radius", 9)
  vim.lsp.buf.hover()
  wait("the hover", floating)
  seen.hover = table.concat(vim.api.nvim_buf_get_lines(vim.api.nvim_win_get_buf(floating()), 0, -1, false), "\n")
  vim.api.nvim_win_close(floating(), true)

  go_to("world: {timestep: 32 ms", 6)
  replace("world: {timestep: 32 ms", "world:    {timestep:   32 ms ")
  vim.lsp.buf.format()
  seen.formatted = text():match("world:[^,]*")

  go_to("delta(metric)", 6)
  local keys = vim.api.nvim_replace_termcodes("ct)me<C-x><C-o>", true, false, true)
  vim.api.nvim_create_autocmd("CompleteChanged", {
    callback = function()
      seen.offered = vim.tbl_map(function(item) return item.word end, vim.fn.complete_info({ "items" }).items)
    end,
  })
  vim.api.nvim_input(keys)
  wait("the offers", function() return seen.offered end)
  vim.api.nvim_input("<C-e><Esc>")
  wait("normal mode", function() return vim.api.nvim_get_mode().mode == "n" end)
  vim.cmd("silent undo")

  go_to("joint: pitch", 7)
  vim.lsp.buf.definition()
  wait("the definition", function() return vim.fn.expand("%:t") == "roller.urdf" end)
  seen.definition = vim.api.nvim_get_current_line()

  client:stop()
  wait("the end of the server", function() return #vim.lsp.get_clients() == 0 end)
end

vim.o.swapfile = false
coroutine.wrap(function()
  local worked, fault = pcall(ask)
  if not worked then seen.fault = fault end
  vim.fn.writefile({ vim.json.encode(seen) }, vim.env.SEEN)
  vim.cmd("quitall!")
end)()
