// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {
    AccessControlDefaultAdminRules
} from "@openzeppelin/contracts/access/extensions/AccessControlDefaultAdminRules.sol";
import {IERC20} from "@openzeppelin/contracts/token/ERC20/IERC20.sol";
import {SafeERC20} from "@openzeppelin/contracts/token/ERC20/utils/SafeERC20.sol";
import {ERC165Checker} from "@openzeppelin/contracts/utils/introspection/ERC165Checker.sol";
import {Math} from "@openzeppelin/contracts/utils/math/Math.sol";
import {Multicall} from "@openzeppelin/contracts/utils/Multicall.sol";
import {DeviceRegistry} from "./DeviceRegistry.sol";
import {IDeviceRegistry, Revocation} from "./interfaces/IDeviceRegistry.sol";
import {IJudge} from "./interfaces/IJudge.sol";
import {IMatchingPolicy} from "./interfaces/IMatchingPolicy.sol";
import {
    Budget,
    GRACE_STEP,
    IDecidedByMembers,
    IOrganization,
    JUDGE_GAS,
    Kind,
    MAX_CASE,
    MAX_GRACE,
    MAX_KINDS,
    MAX_PAUSE,
    MAX_RULES,
    MAX_WINDOW,
    MIN_VOTERS,
    MIN_WINDOW,
    Windows
} from "./interfaces/IOrganization.sol";
import {Terms} from "./interfaces/IProviders.sol";
import {IServiceManager, ServiceState} from "./interfaces/IServiceManager.sol";
import {ITaskManager, TaskRequest} from "./interfaces/ITaskManager.sol";
import {FirstComeFirstServed} from "./policies/FirstComeFirstServed.sol";
import {KindId, NO_KIND} from "./types/KindId.sol";
import {ALLOCATOR_ROLE, GUARDIAN_ROLE, MEMBER_ROLE, OPERATOR_ROLE, TREASURER_ROLE} from "./types/Roles.sol";
import {ServiceId} from "./types/ServiceId.sol";
import {TaskId} from "./types/TaskId.sol";

// The mapping `kindNumbered` implements the function of that name, which Slither does not see through KindId.
// slither-disable-next-line unimplemented-functions
contract Organization is IOrganization, AccessControlDefaultAdminRules, Multicall {
    using SafeERC20 for IERC20;

    /// @inheritdoc IOrganization
    IERC20 public immutable token;
    /// @inheritdoc IOrganization
    IServiceManager public immutable services;
    /// @inheritdoc IOrganization
    ITaskManager public immutable tasks;
    /// @inheritdoc IOrganization
    IDeviceRegistry public immutable devices = new DeviceRegistry();
    /// @dev The hash of its code, so that this contract does not contain that.
    bytes32 private immutable _firstComeFirstServed = keccak256(type(FirstComeFirstServed).runtimeCode);
    /// @inheritdoc IOrganization
    IMatchingPolicy public policy;
    /// @inheritdoc IOrganization
    bool public membersOnly;
    /// @inheritdoc IOrganization
    uint40 public pausedUntil;
    /// @dev The policy is FirstComeFirstServed, which nobody has to call. In the policy's word.
    bool private _firstCome;
    /// @inheritdoc IOrganization
    uint32 public memberCount;
    /// @inheritdoc IOrganization
    mapping(address provider => bool) public isSuspended;
    Terms private _terms;
    uint8 private _kindCount;
    mapping(bytes32 kind => Kind) private _kinds;
    /// @inheritdoc IOrganization
    mapping(bytes32 kind => uint96) public referencePriceOf;
    /// @inheritdoc IOrganization
    mapping(KindId number => bytes32) public kindNumbered;
    /// @inheritdoc IOrganization
    mapping(KindId number => IJudge) public judgeNumbered;
    /// @inheritdoc IOrganization
    IJudge public auditors;
    /// @dev The newest last.
    mapping(bytes32 kind => bytes32[]) private _rules;
    /// @dev The last of them, or 0, so that most tasks find their rules in one word.
    mapping(bytes32 kind => bytes32) private _newestRules;
    mapping(bytes32 role => Budget) private _budgets;

    modifier onlyGuardianOrAdministrator() {
        _requireGuardianOrAdministrator();
        _;
    }

    /// @param handoverDelay s; that long everybody can see coming who administers the organization next
    /// @param terms_ what services agree to from the beginning
    /// @param services_ may be deployed later, at this address; the same for `tasks_`, which checks it
    constructor(
        IERC20 token_,
        IServiceManager services_,
        ITaskManager tasks_,
        IMatchingPolicy policy_,
        address administrator,
        uint48 handoverDelay,
        Terms memory terms_
    ) AccessControlDefaultAdminRules(handoverDelay, administrator) {
        token = token_;
        services = services_;
        tasks = tasks_;
        _setPolicy(policy_);
        _setTerms(terms_);
        // What leaves this way are rewards and bonds of what only the operator can register here.
        token_.forceApprove(address(tasks_), type(uint256).max);
    }

    /// @inheritdoc IOrganization
    function allowKind(bytes32 kind, IJudge judge, bytes32 rules) external onlyRole(DEFAULT_ADMIN_ROLE) {
        Kind storage k = _kinds[kind];
        if (k.maxWindow == 0) revert KindWithoutWindows(kind);
        bool same = k.number != NO_KIND && judgeNumbered[k.number] == judge && !tasks.isRemoved(k.number);
        if (!same) _number(kind, k, judge);
        k.allowed = true;
        if (rules != 0) {
            bytes32[] storage current = _rules[kind];
            _remove(current, rules);
            if (current.length == MAX_RULES) revert TooManyRules(kind, MAX_RULES);
            current.push(rules);
            _newestRules[kind] = rules;
        }
        emit KindAllowed(kind, k.number, judge, rules, k.judgesWindow, k.maxCase);
    }

    /// @inheritdoc IOrganization
    function retireRules(bytes32 kind, bytes32 rules) external onlyRole(DEFAULT_ADMIN_ROLE) {
        bytes32[] storage current = _rules[kind];
        if (!_remove(current, rules)) revert RulesNotCurrent(kind, rules);
        _newestRules[kind] = current.length == 0 ? bytes32(0) : current[current.length - 1];
        if (current.length == 0) revert KindWithoutRules(kind);
        emit RulesRetired(kind, rules);
    }

    /// @inheritdoc IOrganization
    function disallowKind(bytes32 kind) external onlyRole(DEFAULT_ADMIN_ROLE) {
        _disallow(kind);
    }

    /// @inheritdoc IOrganization
    function setAuditors(IJudge auditors_) external onlyRole(DEFAULT_ADMIN_ROLE) {
        auditors = auditors_;
        emit AuditorsChanged(auditors_);
    }

    /// @inheritdoc IOrganization
    function setWindows(bytes32 kind, Windows calldata windows, uint96 referencePrice)
        external
        onlyRole(DEFAULT_ADMIN_ROLE)
    {
        Windows memory w = windows;
        _requireWindows(w.minWindow, w.maxWindow);
        _requireWindows(w.minVerdictWindow, w.maxVerdictWindow);
        uint256 longest = Math.min(w.minWindow / 2, MAX_GRACE);
        if (w.grace == 0 || w.grace > longest || w.grace % GRACE_STEP != 0) {
            revert InvalidGrace(w.grace, GRACE_STEP, longest);
        }
        Kind storage k = _kinds[kind];
        (k.minWindow, k.maxWindow, k.grace) = (w.minWindow, w.maxWindow, w.grace);
        (k.minVerdictWindow, k.maxVerdictWindow) = (w.minVerdictWindow, w.maxVerdictWindow);
        k.auditWindow = w.auditWindow;
        if (referencePrice != referencePriceOf[kind]) _setReferencePrice(kind, referencePrice);
        emit WindowsChanged(kind, w, referencePrice);
    }

    /// @inheritdoc IOrganization
    function removeJudge(KindId number) external onlyGuardianOrAdministrator {
        IJudge judge = judgeNumbered[number];
        if (address(judge) == address(0)) revert UnknownNumber(number);
        emit JudgeRemoved(number, judge);
        tasks.removeJudge(number);
        bytes32 kind = kindNumbered[number];
        if (_kinds[kind].number == number) _disallow(kind);
    }

    /// @inheritdoc IOrganization
    function rescueTokens(IERC20 token_, address to) external onlyRole(DEFAULT_ADMIN_ROLE) {
        uint256 amount = tasks.rescue(token_, to);
        if (token_ != token) {
            uint256 own = _balance(token_, address(this));
            uint256 treasury = _balance(token, address(this));
            amount += own;
            if (own != 0) token_.safeTransfer(to, own);
            // The payment token may have a second address.
            bool missing = _balance(token, address(tasks)) < tasks.held();
            if (missing || _balance(token, address(this)) < treasury) revert NotByMistake(token_);
        }
        emit TokensRescued(token_, to, amount);
    }

    /// @inheritdoc IOrganization
    function setTerms(Terms calldata terms_) external onlyRole(DEFAULT_ADMIN_ROLE) {
        _setTerms(terms_);
    }

    /// @inheritdoc IOrganization
    function setMembersOnly(bool membersOnly_) external onlyRole(DEFAULT_ADMIN_ROLE) {
        membersOnly = membersOnly_;
        emit MembersOnlyChanged(membersOnly_);
        _updateAdmission();
    }

    /// @inheritdoc IOrganization
    function vouchFor(address provider, bool vouched) external onlyRole(DEFAULT_ADMIN_ROLE) {
        services.vouch(provider, vouched);
    }

    /// @inheritdoc IOrganization
    function suspendService(ServiceId serviceId) external onlyRole(DEFAULT_ADMIN_ROLE) {
        services.suspend(serviceId);
    }

    /// @inheritdoc IOrganization
    function suspendProvider(address provider) external onlyRole(DEFAULT_ADMIN_ROLE) {
        if (provider == address(this)) revert OrganizationIsProvider();
        _requireNotSuspended(provider);
        isSuspended[provider] = true;
        emit ProviderSuspended(provider);
        services.suspendServicesOf(provider);
    }

    /// @inheritdoc IOrganization
    function reinstateProvider(address provider) external onlyRole(DEFAULT_ADMIN_ROLE) {
        if (!isSuspended[provider]) revert ProviderNotSuspended(provider);
        isSuspended[provider] = false;
        emit ProviderReinstated(provider);
    }

    /// @inheritdoc IOrganization
    function reinstateService(ServiceId serviceId) external onlyRole(DEFAULT_ADMIN_ROLE) {
        _requireNotSuspended(services.providerOf(serviceId));
        services.reinstate(serviceId);
    }

    /// @inheritdoc IOrganization
    function setPolicy(IMatchingPolicy policy_) external onlyRole(DEFAULT_ADMIN_ROLE) {
        _setPolicy(policy_);
        _updateAdmission();
    }

    /// @inheritdoc IOrganization
    function setBudget(bytes32 role, uint96 amount, uint24 period) external onlyRole(DEFAULT_ADMIN_ROLE) {
        if (role != OPERATOR_ROLE && role != TREASURER_ROLE) revert RoleWithoutBudget(role);
        _budgets[role] = Budget(amount, period, uint40(block.timestamp), 0);
        emit BudgetChanged(role, amount, period);
    }

    /// @inheritdoc IOrganization
    function pauseTasks(uint32 duration) external onlyRole(GUARDIAN_ROLE) {
        if (duration == 0 || duration > MAX_PAUSE) revert InvalidPause(duration, MAX_PAUSE);
        uint256 earliest = uint256(pausedUntil) + MAX_PAUSE;
        if (block.timestamp < earliest) revert PausedRecently(earliest);
        uint40 until = uint40(block.timestamp + duration);
        pausedUntil = until;
        emit TasksPaused(msg.sender, until);
        _updateAdmission();
    }

    /// @inheritdoc IOrganization
    function resumeTasks() external onlyGuardianOrAdministrator {
        if (block.timestamp < pausedUntil) pausedUntil = uint40(block.timestamp);
        emit TasksResumed(msg.sender);
        _updateAdmission();
    }

    /// @inheritdoc IOrganization
    function registerDevice(
        address device_,
        bytes32 role,
        address owner_,
        bytes32 name,
        bytes32 r,
        bytes32 vs
    ) external onlyRole(DEFAULT_ADMIN_ROLE) {
        devices.registerDevice(device_, role, owner_, name, r, vs, msg.sender);
        services.providers().recordOwner(device_, owner_);
    }

    /// @inheritdoc IOrganization
    function revokeDevice(address device_, Revocation reason) external onlyRole(DEFAULT_ADMIN_ROLE) {
        devices.revokeDevice(device_, reason);
    }

    /// @inheritdoc IOrganization
    function registerTask(TaskRequest calldata request) external onlyRole(OPERATOR_ROLE) returns (TaskId) {
        _spend(OPERATOR_ROLE, request.reward);
        return tasks.registerTask(request);
    }

    /// @inheritdoc IOrganization
    function cancelTask(TaskId taskId) external onlyRole(OPERATOR_ROLE) {
        tasks.cancelTask(taskId);
    }

    /// @inheritdoc IOrganization
    function acceptTask(TaskId taskId, uint8 attempt) external onlyRole(OPERATOR_ROLE) {
        tasks.acceptTask(taskId, attempt);
    }

    /// @inheritdoc IOrganization
    function abandonTask(TaskId taskId, uint8 attempt) external onlyRole(OPERATOR_ROLE) {
        tasks.abandonTask(taskId, attempt);
    }

    /// @inheritdoc IOrganization
    function submitProof(TaskId taskId, uint8 attempt, bytes32 proofHash, string calldata uri)
        external
        onlyRole(OPERATOR_ROLE)
    {
        tasks.submitProof(taskId, attempt, proofHash, uri);
    }

    /// @inheritdoc IOrganization
    function registerService(
        bytes32 kind,
        uint256 price,
        uint256 maxBond,
        bool autoAccept,
        string calldata description
    ) external onlyRole(OPERATOR_ROLE) returns (ServiceId) {
        _spend(OPERATOR_ROLE, _terms.bond);
        return services.registerService(kind, price, maxBond, autoAccept, description);
    }

    /// @inheritdoc IOrganization
    function updateService(ServiceId serviceId, uint256 price, ServiceState state)
        external
        onlyRole(OPERATOR_ROLE)
    {
        services.updateService(serviceId, price, state);
    }

    /// @inheritdoc IOrganization
    function agree(ServiceId serviceId) external onlyRole(OPERATOR_ROLE) {
        services.agree(serviceId);
    }

    /// @inheritdoc IOrganization
    function deposit(uint256 amount) external onlyRole(TREASURER_ROLE) {
        emit Deposited(msg.sender, amount);
        token.safeTransferFrom(msg.sender, address(this), amount);
    }

    /// @inheritdoc IOrganization
    function withdraw(address to, uint256 amount) external onlyRole(TREASURER_ROLE) {
        _spend(TREASURER_ROLE, amount);
        _withdraw(to, amount);
    }

    /// @inheritdoc IOrganization
    function payShare(address to, uint256 amount) external onlyRole(ALLOCATOR_ROLE) {
        _withdraw(to, amount);
    }

    /// @inheritdoc IOrganization
    function terms() external view returns (Terms memory) {
        return _terms;
    }

    /// @inheritdoc IOrganization
    function budgetOf(bytes32 role) external view returns (Budget memory) {
        return _budgets[role];
    }

    /// @inheritdoc IOrganization
    function kindOf(bytes32 kind) external view returns (Kind memory) {
        return _kinds[kind];
    }

    /// @inheritdoc IOrganization
    function currentRules(bytes32 kind) external view returns (bytes32[] memory) {
        return _rules[kind];
    }

    /// @inheritdoc IOrganization
    function isMember(address account) public view returns (bool) {
        return hasRole(MEMBER_ROLE, account);
    }

    /// @inheritdoc IOrganization
    function numberOf(bytes32 kind) external view returns (KindId) {
        return _kinds[kind].number;
    }

    /// @inheritdoc IOrganization
    function admitTask(
        bytes32 kind,
        address creator,
        uint32 executionWindow,
        uint32 verdictWindow,
        bytes32 wantedRules,
        bool restricted
    ) external view returns (bytes32, KindId, uint32, uint32) {
        if (restricted) {
            uint40 until = pausedUntil;
            if (block.timestamp < until) revert TasksArePaused(until);
            _requireAdmitted(creator);
        }
        Kind storage rules = _allowed(kind);
        if (executionWindow < rules.minWindow || executionWindow > rules.maxWindow) {
            revert InvalidWindow(kind, executionWindow, rules.minWindow, rules.maxWindow);
        }
        _requireVerdictWindow(kind, rules, verdictWindow);
        return (_rulesFor(kind, wantedRules), rules.number, rules.auditWindow, rules.grace);
    }

    /// @inheritdoc IOrganization
    function admission() external view returns (bool asks, bool restricted) {
        return (!_firstCome, membersOnly || block.timestamp < pausedUntil);
    }

    /// @inheritdoc IOrganization
    function admitService(bytes32 kind, address provider) external view returns (Terms memory, KindId) {
        Kind storage rules = _allowed(kind);
        _requireAdmitted(provider);
        _requireNotSuspended(provider);
        return (_terms, rules.number);
    }

    /// @dev The organization vouches for its members. A key has no code, or what EIP-7702 lets it have: the 23 bytes that name a
    /// contract.
    // slither-disable-next-line dead-code
    function _grantRole(bytes32 role, address account) internal override returns (bool granted) {
        if (role == ALLOCATOR_ROLE && account.code.length <= 23) revert NotAContract(account);
        granted = super._grantRole(role, account);
        if (!granted || role != MEMBER_ROLE) return granted;
        ++memberCount;
        services.vouch(account, true);
    }

    /// @dev A former member of an organization for members only gets no more tasks, however the role was lost.
    // slither-disable-next-line dead-code
    function _revokeRole(bytes32 role, address account) internal override returns (bool revoked) {
        revoked = super._revokeRole(role, account);
        if (!revoked || role != MEMBER_ROLE) return revoked;
        --memberCount;
        _requireVoters();
        services.vouch(account, false);
        if (membersOnly) services.suspendServicesOf(account);
    }

    function _acceptDefaultAdminTransfer() internal override {
        super._acceptDefaultAdminTransfer();
        _requireVoters();
    }

    function _requireVoters() private view {
        if (memberCount >= MIN_VOTERS) return;
        bytes4 byMembers = type(IDecidedByMembers).interfaceId;
        if (ERC165Checker.supportsERC165InterfaceUnchecked(defaultAdmin(), byMembers)) {
            revert TooFewMembers(memberCount, MIN_VOTERS);
        }
    }

    /// @dev One place for the call, whose code would stand here four times.
    function _balance(IERC20 token_, address account) private view returns (uint256) {
        return token_.balanceOf(account);
    }

    function _withdraw(address to, uint256 amount) private {
        emit Withdrawn(to, amount);
        token.safeTransfer(to, amount);
    }

    /// @dev Another number of the kind, with another judge: nobody's work comes under a judge that it did not agree to, nor
    /// under rules that another one follows.
    function _number(bytes32 kind, Kind storage k, IJudge judge) private {
        if (_kindCount == MAX_KINDS) revert TooManyKinds(kind, MAX_KINDS);
        _retireAll(kind);
        if (address(judge).code.length == 0) revert InvalidJudge(kind, address(judge));
        (bytes4 magic, uint32 window, uint32 longest) = judge.termsFor{gas: JUDGE_GAS}(kind);
        if (magic != IJudge.termsFor.selector || window < MIN_WINDOW || longest > MAX_CASE) {
            revert InvalidJudge(kind, address(judge));
        }
        (k.judgesWindow, k.maxCase, k.number) = (window, longest, KindId.wrap(++_kindCount));
        (kindNumbered[k.number], judgeNumbered[k.number]) = (kind, judge);
        tasks.recordJudge(k.number, address(judge), referencePriceOf[kind]);
    }

    /// @dev Also of the numbers that the kind had with earlier judges, whose tasks may still run.
    function _setReferencePrice(bytes32 kind, uint96 price) private {
        referencePriceOf[kind] = price;
        for (uint8 i = _kindCount; i > 0; --i) {
            KindId number = KindId.wrap(i);
            if (kindNumbered[number] != kind) continue;
            tasks.recordJudge(number, address(judgeNumbered[number]), price);
        }
    }

    function _allowed(bytes32 kind) private view returns (Kind storage rules) {
        rules = _kinds[kind];
        if (!rules.allowed) revert UnknownKind(kind);
    }

    /// @dev After each change of policy, membership or pause.
    function _updateAdmission() private {
        tasks.updateAdmission();
    }

    /// @dev The organization itself needs no membership.
    function _requireAdmitted(address participant) private view {
        if (membersOnly && participant != address(this) && !isMember(participant)) {
            revert NotMember(participant);
        }
    }

    function _requireGuardianOrAdministrator() private view {
        if (!hasRole(GUARDIAN_ROLE, msg.sender)) _checkRole(DEFAULT_ADMIN_ROLE);
    }

    function _requireNotSuspended(address provider) private view {
        if (isSuspended[provider]) revert ProviderIsSuspended(provider);
    }

    /// @dev Take `amount` from the budget of `role` before it leaves the treasury.
    function _spend(bytes32 role, uint256 amount) private {
        Budget storage budget = _budgets[role];
        if (budget.period == 0) return;
        if (block.timestamp >= uint256(budget.since) + budget.period) {
            (budget.since, budget.spent) = (uint40(block.timestamp), 0);
        }
        uint256 left = budget.amount - budget.spent;
        if (amount > left) revert OverBudget(role, amount, left, uint256(budget.since) + budget.period);
        budget.spent += uint96(amount);
    }

    /// @dev The rules by which a task is judged whose creator wants `wanted`.
    function _rulesFor(bytes32 kind, bytes32 wanted) private view returns (bytes32) {
        bytes32 newest = _newestRules[kind];
        if (wanted == 0 || wanted == newest) return newest;
        bytes32[] storage current = _rules[kind];
        for (uint256 i = current.length; i > 0; --i) {
            if (current[i - 1] == wanted) return wanted;
        }
        revert RulesNotCurrent(kind, wanted);
    }

    function _requireVerdictWindow(bytes32 kind, Kind storage rules, uint32 window) private view {
        (uint32 min, uint32 max) = (rules.minVerdictWindow, rules.maxVerdictWindow);
        if (min < rules.judgesWindow) min = rules.judgesWindow;
        uint32 longest = rules.auditWindow < rules.maxCase ? rules.maxCase - rules.auditWindow : 0;
        if (max > longest) max = longest;
        if (window < min || window > max) revert InvalidVerdictWindow(kind, window, min, max);
    }

    function _requireWindows(uint32 min, uint32 max) private pure {
        if (min < MIN_WINDOW || max > MAX_WINDOW || min > max) {
            revert InvalidWindows(min, max, MIN_WINDOW, MAX_WINDOW);
        }
    }

    function _disallow(bytes32 kind) private {
        _retireAll(kind);
        _kinds[kind].allowed = false;
        emit KindDisallowed(kind);
    }

    function _retireAll(bytes32 kind) private {
        bytes32[] storage current = _rules[kind];
        for (uint256 i = current.length; i > 0; --i) {
            emit RulesRetired(kind, current[i - 1]);
            current.pop();
        }
        _newestRules[kind] = 0;
    }

    /// @dev Whether `rules` was there. The others keep their order.
    function _remove(bytes32[] storage current, bytes32 rules) private returns (bool found) {
        uint256 count = current.length;
        for (uint256 i = 0; i < count; ++i) {
            if (found) current[i - 1] = current[i];
            else found = current[i] == rules;
        }
        if (found) current.pop();
    }

    function _setTerms(Terms memory terms_) private {
        if (terms_.penalty > terms_.bond) {
            revert InvalidTerms(terms_.bond, terms_.penalty, terms_.maxFailures);
        }
        _terms = terms_;
        emit TermsChanged(terms_.bond, terms_.penalty, terms_.maxFailures);
    }

    function _setPolicy(IMatchingPolicy policy_) private {
        if (address(policy_).code.length == 0) revert InvalidPolicy(address(policy_));
        policy = policy_;
        _firstCome = address(policy_).codehash == _firstComeFirstServed;
        emit PolicyChanged(policy_);
    }
}
